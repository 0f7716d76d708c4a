"""The scene "mic": a studio microphone on a small tripod with its cable; the rod bends, the rest rides on it."""

import numpy as np

from .. import meshes as m
from .. import textures as t
from ..scene import AreaLight, Gradient, Part, Scene, Surface, part

_IVORY = (0.93, 0.9, 0.82)
_RED = (0.82, 0.12, 0.1)

_rng = t.seeded(2025)
FLOOR = -0.86
PIVOT = np.array([0.0, 0.0, 0.40])  # where the microphone's axis crosses the rod's
RADIUS = 0.235  # of the microphone's body
FOOT_RADIUS = 0.74
LEG_HEADINGS = np.radians([-75.0, 45.0, 165.0])
_UP = (0.0, 0.0, 1.0)

_COLLAR = [
    (RADIUS - 0.03, 0.145), (RADIUS + 0.008, 0.145), (RADIUS + 0.014, 0.155), (RADIUS + 0.014, 0.215),
    (RADIUS + 0.006, 0.225), (RADIUS - 0.02, 0.225),
]  # fmt: skip
_RIM = [
    (RADIUS - 0.028, 0.80), (RADIUS + 0.006, 0.80), (RADIUS + 0.012, 0.808), (RADIUS + 0.012, 0.872),
    (RADIUS + 0.004, 0.882), (RADIUS - 0.028, 0.882), (RADIUS - 0.034, 0.86), (RADIUS - 0.028, 0.80),
]  # fmt: skip
_CORE = [(0.0, 0.215), (0.165, 0.215), (0.165, 0.80), (0.13, 0.86), (0.07, 0.895), (0.0, 0.905)]
_KNOB = [(0.036, 0.0), (0.036, 0.03), (0.026, 0.036), (0.026, 0.085), (0.02, 0.095), (0.0, 0.097)]
_ROD = [
    (0.0, -0.40), (0.033, -0.40), *((0.033, z) for z in np.linspace(-0.38, 0.08, 24)), (0.033, 0.1),
    (0.0, 0.1),
]  # fmt: skip
_BOLT = [(0.0, -0.09), (0.03, -0.09), (0.03, 0.09), (0.045, 0.09), (0.045, 0.1), (0.0, 0.1)]
_THUMB = [(0.0, -0.135), (0.05, -0.135), (0.058, -0.127), (0.058, -0.098), (0.05, -0.09), (0.0, -0.09)]
_HUB = [
    (0.0, -0.56), (0.09, -0.56), (0.125, -0.535), (0.135, -0.50), (0.135, -0.475), (0.12, -0.45),
    (0.075, -0.41), (0.06, -0.39), (0.06, -0.365), (0.052, -0.36), (0.0, -0.36),
]  # fmt: skip
_FOOT = [
    (0.0, 0.0), (0.062, 0.0), (0.07, 0.008), (0.07, 0.024), (0.058, 0.034), (0.04, 0.052), (0.0, 0.056),
]  # fmt: skip
_PLUG = [
    (0.0, -0.70), (0.032, -0.70), (0.04, -0.69), (0.046, -0.66), (0.046, -0.64), (0.058, -0.635),
    (0.058, -0.57), (0.05, -0.56), (0.05, -0.545),
]  # fmt: skip
# Where the cable runs behind the microphone: (backwards, sideways, height).
_CABLE = [
    (1.0, 0.01, -0.06), (1.09, 0.08, -0.3), (1.06, 0.25, -0.62), (0.93, 0.45, -0.80),
    (0.68, 0.68, FLOOR + 0.034), (0.18, 0.9, FLOOR + 0.03), (-0.35, 0.93, FLOOR + 0.03),
    (-0.75, 0.72, FLOOR + 0.03), (-0.98, 0.35, FLOOR + 0.03), (-0.98, -0.1, FLOOR + 0.03),
    (-0.72, -0.5, FLOOR + 0.03),
]  # fmt: skip
_HEADING, _TILT = np.radians(-60.0), np.radians(20.0)
AXIS = np.array([np.cos(_TILT) * np.cos(_HEADING), np.cos(_TILT) * np.sin(_HEADING), np.sin(_TILT)])
_LEVEL = np.array([np.cos(_HEADING), np.sin(_HEADING), 0.0])  # the axis, levelled
_ACROSS = np.array([-_LEVEL[1], _LEVEL[0], 0.0])


def body() -> Surface:
    h, w = 1024, 1536
    image = t.speckle(t.flat(h, w, (0.34, 0.36, 0.4)), _rng(1), 0.4, (20, 34))
    image = t.paint(image, t.band(h, w, 0.33, 0.345), _RED)
    image = t.paint(image, t.band(h, w, 0.80, 0.83), _IVORY)
    image = t.paint(image, t.band(h, w, 0.80, 0.83) * t.checker(h, w, (h, 48)), (0.1, 0.1, 0.12))
    ink = t.ticks(h, w, 50, 0.36, (0.025, 0.04, 0.06), 0.3)
    for u in (0.25, 0.75):
        ink = t.stamp(ink, t.lettering("TG-4", 13), 0.63, u)
        ink = t.stamp(ink, t.lettering("STUDIO CONDENSER", 4), 0.52, u)
    image = t.paint(image, ink, _IVORY)
    return Surface("body", image, relief=1.0 - ink, relief_depth=0.003, metallic=0.3, roughness=0.5)


def brass() -> Surface:
    h, w = 256, 1024
    relief = t.knurl(h, w, 4.0, 30)
    image = t.speckle(t.flat(h, w, (0.80, 0.62, 0.36)), _rng(2), 0.2, (8, 120))
    return Surface("brass", image * (0.5 + 0.5 * relief[..., None]), relief, 0.005, 0.5, 0.5)


def wire() -> Surface:
    image = t.speckle(t.flat(256, 32, (0.72, 0.72, 0.7)), _rng(3), 0.15, (12, 1))
    return Surface("wire", image, metallic=0.3, roughness=0.55)


def foam() -> Surface:
    h, w = 384, 384
    image = t.speckle(t.flat(h, w, (0.42, 0.34, 0.26)), _rng(4), 0.45, (10, 16))
    return Surface("foam", image, roughness=0.9)


def switch() -> Surface:
    image = t.speckle(t.flat(128, 128, _RED), _rng(5), 0.15, (10, 14))
    return Surface("switch", t.paint(image, t.band(128, 128, 0.45, 0.55), _IVORY), roughness=0.4)


def rod() -> Surface:
    h, w = 1024, 96
    image = t.speckle(t.flat(h, w, (0.74, 0.74, 0.76)), _rng(6), 0.12, (200, 4))
    marks = t.ruler(h, w, 20, 0.2)
    return Surface("rod", t.paint(image, marks, (0.08, 0.08, 0.1)), 1.0 - marks, 0.002, 0.75, 0.3)


def casting() -> Surface:
    image = t.speckle(t.flat(384, 384, (0.3, 0.31, 0.33)), _rng(7), 0.5, (8, 10))
    return Surface("casting", image, metallic=0.4, roughness=0.5)


def thumb_screw() -> Surface:
    h, w = 128, 384
    relief = t.diagonal(h, w, 0.0, 28)
    image = t.flat(h, w, (0.5, 0.5, 0.52)) * (0.45 + 0.55 * relief[..., None])
    return Surface("thumb_screw", t.paint(image, t.band(h, w, 0.14, 0.24), _RED), relief, 0.006, 0.5, 0.4)


def hub() -> Surface:
    h, w = 512, 768
    image = t.speckle(t.flat(h, w, (0.27, 0.28, 0.31)), _rng(8), 0.45, (8, 20))
    image = t.paint(image, t.ticks(h, w, 36, 0.36, (0.04, 0.06, 0.08), 0.35), _IVORY)
    return Surface(
        "hub", t.paint(image, t.band(h, w, 0.56, 0.58), (0.8, 0.62, 0.3)), metallic=0.4, roughness=0.45
    )


def legs() -> Surface:
    h, w = 512, 128
    image = t.speckle(t.flat(h, w, (0.3, 0.31, 0.34)), _rng(9), 0.45, (24, 4))
    for v in (0.3, 0.34, 0.62, 0.66, 0.70):
        image = t.paint(image, t.band(h, w, v, v + 0.018), _IVORY)
    return Surface("legs", image, metallic=0.4, roughness=0.45)


def rubber() -> Surface:
    h, w = 128, 256
    relief = t.diagonal(h, w, 0.0, 24)
    image = t.speckle(t.flat(h, w, (0.2, 0.2, 0.21)), _rng(10), 0.3, (12, 24)) * (
        0.6 + 0.6 * relief[..., None]
    )
    return Surface("rubber", image, relief, 0.004, 0.0, 0.8)


def plug() -> Surface:
    h, w = 256, 128
    image = t.speckle(t.flat(h, w, (0.25, 0.25, 0.27)), _rng(11), 0.35, (40, 16))
    return Surface("plug", t.paint(image, t.ruler(h, w, 14, 0.35), (0.62, 0.62, 0.6)), roughness=0.55)


def cable() -> Surface:
    h, w = 2048, 48
    strands = np.maximum(t.diagonal(h, w, 55.0, 1) > 0.7, t.diagonal(h, w, -55.0, 1) > 0.88).astype(float)
    image = t.speckle(t.flat(h, w, (0.26, 0.26, 0.29)), _rng(12), 0.3, (120, 4))
    return Surface("cable", t.paint(image, 0.8 * strands, (0.78, 0.72, 0.6)), roughness=0.65)


def _groove(z: float, depth: float = 0.012, width: float = 0.022) -> list[tuple[float, float]]:
    """Four points of the body's outline: a turned groove."""
    inner = RADIUS - depth
    return [(RADIUS, z - width / 2), (inner, z - width / 4), (inner, z + width / 4), (RADIUS, z + width / 2)]


# Outlines of turned parts, (radius, height along their axis).
_BODY = [
    (0.0, -0.56), (0.1, -0.56), (0.1, -0.545), (RADIUS - 0.03, -0.545), (RADIUS - 0.008, -0.53),
    (RADIUS, -0.505), *_groove(-0.46), *_groove(-0.415), (RADIUS, -0.2), (RADIUS, 0.0), *_groove(0.1),
    (RADIUS, 0.135), (RADIUS - 0.012, 0.15),
]  # fmt: skip


def build() -> Scene:
    return Scene(
        name="mic",
        parts=(*_microphone(), *_stand(), *_tripod(), *_cable()),
        # One soft box and a sky with a strong gradient: further lamps would add noise sooner than shape.
        lights=(AreaLight((3.2, -3.0, 3.6), 3.0, 170.0, (1.0, 0.94, 0.85)),),
        sky=Gradient(((0.2, 0.15, 0.12), (0.46, 0.43, 0.42), (0.8, 0.92, 1.15))),
    )


def _microphone() -> tuple[Part, ...]:
    at = m.frame(PIVOT, AXIS)
    on_top = m.frame(PIVOT + at[:3, 0] * (RADIUS - 0.008) + AXIS * 0.02, at[:3, 0], AXIS)
    rings = m.join([m.revolve(_COLLAR, 72), m.revolve(_RIM, 72)])
    return (
        part("body", m.revolve(_BODY, 72).moved(at), body()),
        part("collar", rings.moved(at), brass()),
        part("grille", m.join([*_weave(), *_dome()]).moved(at), wire()),
        part("core", m.revolve(_CORE, 48).moved(at), foam()),
        part("switch", m.revolve(_KNOB, 24).moved(on_top), switch()),
    )


def _weave(
    count: int = 24, radius: float = RADIUS - 0.016, low: float = 0.22, high: float = 0.81
) -> list[m.Mesh]:
    """The grille's side: wires at ±45° that go over and under each other in turn; `count` each way, even.

    On the unrolled cylinder a wire of one hand keeps angle − height constant, one of the other angle +
    height, so they cross every π / count of height (in radii). Two steps per crossing put a vertex on each.
    """
    step = np.pi / (2 * count)
    steps = int((high - low) / (radius * step))
    height = step * np.arange(steps + 1)
    wires = []
    for number in range(count):
        for hand in (1, -1):
            start = 2 * np.pi * (number + (0.5 if hand > 0 else 0.0)) / count
            angle = start + hand * height
            # Number of the wire being crossed: whole at crossings; neighbours lie on opposite sides.
            crossing = (angle + height if hand > 0 else angle - height) * count / (2 * np.pi)
            crossing -= 0.0 if hand > 0 else 0.5
            reach = radius + hand * 0.008 * np.cos(np.pi * (crossing + number))
            path = np.column_stack([reach * np.cos(angle), reach * np.sin(angle), low + radius * height])
            wires.append(m.sweep(path, m.circle(0.0088, 6), up=path[0] * [1, 1, 0], caps=False))
    return wires


def _dome() -> list[m.Mesh]:
    base, bulge, wire = RADIUS - 0.026, 0.085, m.circle(0.0085, 6)
    wires = []
    for ring_radius in base * np.arange(1, 5) / 5.0:
        angle = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
        z = np.full_like(angle, 0.868 + bulge * (1.0 - (ring_radius / base) ** 2))
        ring = np.column_stack([ring_radius * np.cos(angle), ring_radius * np.sin(angle), z])
        wires.append(m.sweep(ring, wire, up=(1.0, 0.0, 0.0), closed=True))
    r = np.linspace(-base, base, 25)
    for heading in np.linspace(0.0, np.pi, 12, endpoint=False):
        z = 0.868 + bulge * (1.0 - (r / base) ** 2)
        wires.append(
            m.sweep(np.column_stack([r * np.cos(heading), r * np.sin(heading), z]), wire, caps=False)
        )
    return wires


def _stand() -> tuple[Part, ...]:
    block_path = np.array([[0.0, 0.0, z] for z in np.linspace(0.03, 0.17, 8)])
    block = m.sweep(block_path, m.rounded_rectangle(0.13, 0.115, 0.025), up=_LEVEL)
    arc = [(0.072 * np.sin(a), -0.072 * np.cos(a)) for a in np.linspace(0.0, np.pi, 13)]
    ball = m.revolve(arc, 28).moved(m.frame((0.0, 0.0, 0.15), _ACROSS))
    screw = m.frame((0.0, 0.0, 0.135), _ACROSS)
    # The saddle hugs the body from below: an arc of a ring around the microphone's axis.
    angles = np.linspace(np.radians(118.0), np.radians(242.0), 22)
    path = (RADIUS + 0.008) * np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)])
    saddle = m.sweep(path, m.rounded_rectangle(0.13, 0.03, 0.012), up=_UP).moved(m.frame(PIVOT, AXIS))
    swivel = m.join([block, ball, m.revolve(_BOLT, 24).moved(screw), saddle])
    return (
        part("rod", m.revolve(_ROD, 24), rod()),
        part("swivel", swivel, casting()),
        part("thumb_screw", m.revolve(_THUMB, 32).moved(screw), thumb_screw()),
    )


def _tripod() -> tuple[Part, ...]:
    bars, feet = [], []
    for heading in LEG_HEADINGS:
        out = np.array([np.cos(heading), np.sin(heading), 0.0])
        start, end = out * 0.09 + [0, 0, -0.49], out * FOOT_RADIUS + [0, 0, FLOOR + 0.035]
        path = start + (end - start) * np.linspace(0.0, 1.0, 18)[:, None]
        bars.append(m.sweep(path, m.rounded_rectangle(0.05, 0.075, 0.014), np.linspace(1.15, 0.75, 18)))
        feet.append(m.revolve(_FOOT, 28).moved(m.frame(out * FOOT_RADIUS + [0, 0, FLOOR], _UP, out)))
    return (
        part("hub", m.revolve(_HUB, 48), hub(), 0.0),
        part("legs", m.join(bars), legs(), 0.0),
        part("feet", m.join(feet), rubber(), 0.0),
    )


def _cable() -> tuple[Part, ...]:
    run = [-back * _LEVEL - side * _ACROSS + [0.0, 0.0, z] for back, side, z in _CABLE]
    path = m.spline([PIVOT - AXIS * 0.66, PIVOT - AXIS * 0.78, *run], per_span=14)
    tube = m.sweep(path, m.circle(0.027, 12))
    landed = int(np.argmax(path[:, 2] < FLOOR + 0.05))
    hanging = np.clip(1.0 - np.arange(len(path)) / landed, 0.0, 1.0)
    follow = hanging**2 * (3.0 - 2.0 * hanging)  # smooth at both ends
    nearest = np.argmin(np.linalg.norm(tube.vertices[:, None] - path[None], axis=2), axis=1)
    return (
        part("plug", m.revolve(_PLUG, 32).moved(m.frame(PIVOT, AXIS)), plug()),
        part("cable", tube, cable(), follow[nearest]),
    )
