"""Surfaces of the microphone: paint, engraving, scales and braid, so that every part shows where it moves."""

from __future__ import annotations

import numpy as np

from .. import textures as t
from ..scene import Surface

_IVORY = (0.93, 0.9, 0.82)
_RED = (0.82, 0.12, 0.1)

_rng = t.seeded(2025)


def body() -> Surface:
    """Hammered gunmetal with an engraved scale, two painted rings and lettering."""
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
    """Knurled brass rings."""
    h, w = 256, 1024
    relief = t.knurl(h, w, 4.0, 30)
    image = t.speckle(t.flat(h, w, (0.80, 0.62, 0.36)), _rng(2), 0.2, (8, 120))
    return Surface("brass", image * (0.5 + 0.5 * relief[..., None]), relief, 0.005, 0.5, 0.5)


def wire() -> Surface:
    """Bright wire, a little stained along its length."""
    image = t.speckle(t.flat(256, 32, (0.72, 0.72, 0.7)), _rng(3), 0.15, (12, 1))
    return Surface("wire", image, metallic=0.3, roughness=0.55)


def foam() -> Surface:
    """The capsule's cover: dark cloth with a light lattice."""
    h, w = 384, 384
    image = t.speckle(t.flat(h, w, (0.42, 0.34, 0.26)), _rng(4), 0.45, (10, 16))
    return Surface("foam", image, roughness=0.9)


def switch() -> Surface:
    """Red knob with a light top."""
    image = t.speckle(t.flat(128, 128, _RED), _rng(5), 0.15, (10, 14))
    return Surface("switch", t.paint(image, t.band(128, 128, 0.45, 0.55), _IVORY), roughness=0.4)


def rod() -> Surface:
    """Steel with a ruler along it."""
    h, w = 1024, 96
    image = t.speckle(t.flat(h, w, (0.74, 0.74, 0.76)), _rng(6), 0.12, (200, 4))
    marks = t.ruler(h, w, 20, 0.2)
    return Surface("rod", t.paint(image, marks, (0.08, 0.08, 0.1)), 1.0 - marks, 0.002, 0.75, 0.3)


def casting() -> Surface:
    """Grainy cast metal."""
    image = t.speckle(t.flat(384, 384, (0.3, 0.31, 0.33)), _rng(7), 0.5, (8, 10))
    return Surface("casting", image, metallic=0.4, roughness=0.5)


def thumb_screw() -> Surface:
    """Knurled thumb screw with a red face ring."""
    h, w = 128, 384
    relief = t.diagonal(h, w, 0.0, 28)
    image = t.flat(h, w, (0.5, 0.5, 0.52)) * (0.45 + 0.55 * relief[..., None])
    return Surface("thumb_screw", t.paint(image, t.band(h, w, 0.14, 0.24), _RED), relief, 0.006, 0.5, 0.4)


def hub() -> Surface:
    """Dark hub with light rings and a degree scale."""
    h, w = 512, 768
    image = t.speckle(t.flat(h, w, (0.27, 0.28, 0.31)), _rng(8), 0.45, (8, 20))
    image = t.paint(image, t.ticks(h, w, 36, 0.36, (0.04, 0.06, 0.08), 0.35), _IVORY)
    return Surface(
        "hub", t.paint(image, t.band(h, w, 0.56, 0.58), (0.8, 0.62, 0.3)), metallic=0.4, roughness=0.45
    )


def legs() -> Surface:
    """Legs with stripes that get closer towards the feet."""
    h, w = 512, 128
    image = t.speckle(t.flat(h, w, (0.3, 0.31, 0.34)), _rng(9), 0.45, (24, 4))
    for v in (0.3, 0.34, 0.62, 0.66, 0.70):
        image = t.paint(image, t.band(h, w, v, v + 0.018), _IVORY)
    return Surface("legs", image, metallic=0.4, roughness=0.45)


def rubber() -> Surface:
    """Ribbed rubber."""
    h, w = 128, 256
    relief = t.diagonal(h, w, 0.0, 24)
    image = t.speckle(t.flat(h, w, (0.2, 0.2, 0.21)), _rng(10), 0.3, (12, 24)) * (
        0.6 + 0.6 * relief[..., None]
    )
    return Surface("rubber", image, relief, 0.004, 0.0, 0.8)


def plug() -> Surface:
    """Black plug with strain-relief rings."""
    h, w = 256, 128
    image = t.speckle(t.flat(h, w, (0.25, 0.25, 0.27)), _rng(11), 0.35, (40, 16))
    return Surface("plug", t.paint(image, t.ruler(h, w, 14, 0.35), (0.62, 0.62, 0.6)), roughness=0.55)


def cable() -> Surface:
    """Braided cable: two strands of light thread on dark."""
    h, w = 2048, 48
    strands = np.maximum(t.diagonal(h, w, 55.0, 1) > 0.7, t.diagonal(h, w, -55.0, 1) > 0.88).astype(float)
    image = t.speckle(t.flat(h, w, (0.26, 0.26, 0.29)), _rng(12), 0.3, (120, 4))
    return Surface("cable", t.paint(image, 0.8 * strands, (0.78, 0.72, 0.6)), roughness=0.65)
