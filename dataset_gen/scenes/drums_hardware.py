"""Hardware of the drum kit: cymbals on their stands, mounts and legs, pedal, throne. Lengths in scene units."""

from dataclasses import dataclass

import numpy as np

from .. import meshes as m
from ..meshes import Mesh
from ..scene import Surface
from ..shapes import drums as d
from ..shapes import drums as tb
from ..shapes import solids as s
from . import drums_surfaces as paint

FLOOR = -0.74
Named = tuple[str, Mesh, Surface]


@dataclass(frozen=True)
class Cymbal:
    """A cymbal with its hole at `pivot`, tilted to `normal`, above a stand that rises from `foot`."""

    name: str
    radius: float
    pivot: tuple[float, float, float]
    normal: tuple[float, float, float]
    foot: tuple[float, float]
    heading: float  # of the tripod's first leg, degrees
    hammered: float
    text: str


CYMBALS = (
    Cymbal("crash_left", 0.27, (-0.62, 0.30, 0.68), (0.16, -0.3, 0.94), (-0.62, 0.33), 100.0, 0.6, "CRASH"),
    Cymbal(
        "crash_right", 0.24, (0.40, 0.44, 0.74), (-0.05, -0.3, 0.95), (0.42, 0.56), 60.0, 0.9, "TG4M THIN"
    ),
    Cymbal("ride", 0.33, (0.72, 0.08, 0.50), (-0.2, -0.26, 0.94), (0.84, 0.36), 15.0, 1.0, "RIDE"),
)
HIHAT = Cymbal("hihat_top", 0.215, (-0.80, -0.32, 0.30), (0.0, 0.0, 1.0), (-0.80, -0.32), 345.0, 0.5, "HIHAT")


def _bell(radius: float) -> tuple[float, float]:
    return 0.24 * radius, 0.11 * radius


def cymbals() -> list[Named]:
    out = []
    for number, c in enumerate((*CYMBALS, HIHAT)):
        mesh = d.cymbal(c.radius, *_bell(c.radius)).moved(m.frame(c.pivot, c.normal, (1, 0, 0)))
        out.append((c.name, mesh, paint.cymbal(c.name, number, c.hammered, c.text)))
    high = d.cymbal(HIHAT.radius, *_bell(HIHAT.radius))
    low = s.turned(Mesh(high.vertices * [1.0, 1.0, -1.0], high.triangles, high.uv))
    bell, bow = _bell(HIHAT.radius)
    drop = 2.0 * (0.32 * bell + bow) + 0.02
    at = np.asarray(HIHAT.pivot) - [0.0, 0.0, drop]
    out.append(
        ("hihat_bottom", low.moved(m.frame(at, (0, 0, 1))), paint.cymbal("hihat_bottom", 9, 0.5, "HIHAT"))
    )
    return out


def _column(foot: np.ndarray, top: np.ndarray) -> list[Mesh]:
    joint = foot + 0.55 * (top - foot)
    side = np.array([0.6, -0.8, 0.0])
    return [
        tb.tube(np.linspace(foot + [0, 0, 0.06], joint, 5), 0.0175, 0.0145, 18),
        tb.tube(np.linspace(joint - [0, 0, 0.05], top, 5), 0.0125, 0.0095, 16),
        tb.collar(joint, 0.025, 0.045),
        tb.wing_nut(joint + 0.022 * side, side, 0.06),
    ]


def _top(pivot: np.ndarray, normal: np.ndarray, below: float = 0.075) -> tuple[list[Mesh], list[Mesh]]:
    n = normal / np.linalg.norm(normal)
    metal = [
        tb.rod(pivot - below * n, pivot + 0.06 * n, 0.0055, 10),
        tb.collar(pivot - 0.062 * n, 0.02, 0.012, n),
        tb.wing_nut(pivot + 0.034 * n, n, 0.058),
    ]
    felts = [tb.collar(pivot - 0.046 * n, 0.026, 0.016, n), tb.collar(pivot + 0.014 * n, 0.024, 0.02, n)]
    return metal, felts


def stands() -> list[Named]:
    metal, rubber, felts = [], [], []
    for c in (*CYMBALS, HIHAT):
        foot = np.array([*c.foot, FLOOR])
        legs, feet = tb.tripod(foot, 0.25 if c is HIHAT else 0.23, 0.34, np.radians(c.heading))
        metal.append(legs)
        rubber.append(feet)
        pivot, normal = np.asarray(c.pivot), np.asarray(c.normal)
        steel, soft = _top(pivot, normal)
        metal += steel
        felts += soft
        metal += _hihat_column(foot, pivot) if c is HIHAT else _arm(foot, pivot, normal)
    return [
        ("stands", s.cube_mapped(m.join(metal), 0.3), paint.chrome("stands")),
        ("stand_feet", s.cube_mapped(m.join(rubber), 0.2), paint.rubber("stand_feet")),
        ("felts", s.cube_mapped(m.join(felts), 0.15), paint.felt()),
    ]


def _arm(foot: np.ndarray, pivot: np.ndarray, normal: np.ndarray) -> list[Mesh]:
    n = normal / np.linalg.norm(normal)
    end = pivot - 0.075 * n
    elbow = np.array([foot[0], foot[1], end[2] - 0.03 - 0.35 * np.linalg.norm((end - foot)[:2])])
    along = (end - elbow) / np.linalg.norm(end - elbow)
    side = np.cross(along, [0.0, 0.0, 1.0])
    side /= max(float(np.linalg.norm(side)), 1e-9)
    pieces = [*_column(foot, elbow), tb.collar(elbow, 0.026, 0.04, side), tb.collar(end, 0.018, 0.034, side)]
    pieces += [
        tb.wing_nut(elbow + 0.02 * side, side, 0.055),
        tb.wing_nut(end + 0.017 * side, side, 0.045),
        tb.tube(np.linspace(elbow - 0.12 * along, end, 5), 0.0095, 0.007, 14),
        tb.collar(elbow - 0.12 * along, 0.016, 0.03, along),
    ]
    return pieces


def _hihat_column(foot: np.ndarray, pivot: np.ndarray) -> list[Mesh]:
    bell, bow = _bell(HIHAT.radius)
    seat = pivot - [0.0, 0.0, 2.0 * (0.32 * bell + bow) + 0.06]
    return [
        *_column(foot, seat),
        tb.collar(seat, 0.034, 0.03),
        tb.collar(seat + [0, 0, 0.025], 0.03, 0.02),
        tb.rod(foot + [0, 0, 0.02], pivot + [0, 0, 0.2], 0.0045, 10),
        tb.collar(pivot + [0, 0, 0.07], 0.018, 0.05),
    ]


def _footboard(length: float) -> list[Mesh]:
    """A footboard along +y that rises; frame below, ribs on top; the heel is at the origin."""
    rise = np.radians(14.0)
    at = m.frame((0.0, 0.0, 0.022), (0.0, -np.sin(rise), np.cos(rise)), (1.0, 0.0, 0.0))
    board = s.block((-0.05, 0.0, 0.0), (0.05, length, 0.012), 0.003)
    ribs = [
        s.block((-0.04, y, 0.0125), (0.04, y + 0.012, 0.017), 0.002)
        for y in np.arange(0.03, length - 0.03, 0.03)
    ]
    base = s.block((-0.045, -0.03, 0.0005), (0.045, 0.05, 0.02), 0.004)
    rails = [tb.rod((x, 0.03, 0.008), (x, length + 0.06, 0.008), 0.005, 8) for x in (-0.035, 0.035)]
    return [*(piece.moved(at) for piece in (board, *ribs)), base, *rails]


def _hihat_pedal() -> list[Mesh]:
    at = m.frame((-0.735, -0.56, FLOOR), (0, 0, 1), (0.966, 0.259, 0.0))
    return [piece.moved(at) for piece in _footboard(0.2)]


def pedal() -> list[Named]:
    hinge, head = np.array([0.0, -0.22, FLOOR + 0.24]), FLOOR + 0.42
    at = m.frame((0.0, -0.5, FLOOR), (0, 0, 1), (1, 0, 0))
    pieces = [piece.moved(at) for piece in _footboard(0.25)]
    for x in (-0.075, 0.075):
        pieces.append(s.block((x - 0.012, -0.235, FLOOR + 0.004), (x + 0.012, -0.205, FLOOR + 0.26), 0.004))
    pieces += [
        s.block((-0.09, -0.245, FLOOR + 0.0005), (0.09, -0.14, FLOOR + 0.016), 0.004),
        tb.rod(hinge - [0.1, 0, 0], hinge + [0.1, 0, 0], 0.009),
        tb.collar(hinge, 0.035, 0.02, (1, 0, 0)),
        tb.wing_nut(hinge + [0.1, 0, 0], (1, 0, 0), 0.045),
        tb.rod(hinge, (0.0, -0.19, head + 0.03), 0.0055),
    ]
    spring = np.linspace(0.0, 18.0 * np.pi, 160)
    coil = np.column_stack([0.1 + 0.009 * np.cos(spring), -0.22 + 0.009 * np.sin(spring),
                            FLOOR + 0.06 + 0.16 * spring / spring[-1]])  # fmt: skip
    pieces.append(m.sweep(coil, m.circle(0.0022, 6)))
    links = [
        s.block((-0.006, -0.004, -0.006), (0.006, 0.004, 0.006), 0.002).moved(
            m.frame((0.0, -0.255 - 0.0004 * k, FLOOR + 0.235 - 0.014 * k), (0, 0, 1), (1, 1, 0))
        )
        for k in range(11)
    ]
    pieces += [*links, *_hihat_pedal()]
    beater = m.revolve(
        [(0.0, -0.035), (0.028, -0.035), (0.036, -0.025), (0.036, 0.02), (0.026, 0.032), (0.0, 0.034)], 24
    )
    felt = beater.moved(m.frame((0.0, -0.178, head + 0.02), (0.0, 1.0, 0.0)))
    return [
        ("pedal", s.cube_mapped(m.join(pieces), 0.3), paint.black("pedal")),
        (
            "beater",
            s.cube_mapped(felt, 0.15),
            Surface("beater", paint.felt().colour, roughness=0.95, sheen=0.3),
        ),
    ]


def throne() -> list[Named]:
    foot, top = np.array([0.02, -0.80, FLOOR]), -0.16
    legs, feet = tb.tripod(foot, 0.24, 0.3, np.radians(30.0), 0.018)
    r = 0.2
    cushion = [(0.0, -0.085), (r - 0.02, -0.085), (r - 0.004, -0.078), (r, -0.06), (r, -0.03), (r - 0.008, -0.012),
               (r - 0.03, 0.0), (r * 0.6, 0.004), (r * 0.3, -0.004), (0.0, -0.008)]  # fmt: skip
    pad = m.revolve(cushion, 64, sharp_deg=60.0).moved(m.frame((foot[0], foot[1], top), (0, 0, 1)))
    angle = np.linspace(0.0, 2 * np.pi, 72, endpoint=False)
    rings = [
        m.sweep(np.column_stack([foot[0] + k * np.cos(angle), foot[1] + k * np.sin(angle), 0 * angle + top + z]),
                m.circle(0.007, 8), closed=True)
        for k, z in ((r, -0.02), (r, -0.068))
    ]  # fmt: skip
    column = [*_column(foot, np.array([foot[0], foot[1], top - 0.085])),
              tb.collar((foot[0], foot[1], top - 0.096), 0.07, 0.02)]  # fmt: skip
    return [
        ("seat", s.cube_mapped(pad, 0.4), paint.leather()),
        ("piping", m.join(rings), paint.piping()),
        ("throne", s.cube_mapped(m.join([legs, *column]), 0.3), paint.chrome("throne")),
        ("throne_feet", s.cube_mapped(feet, 0.2), paint.rubber("throne_feet")),
    ]


def floor_leg(where: tuple, radius: float, angle: float) -> tuple[Mesh, Mesh, Mesh]:
    """One leg of the floor tom: bent rod, its bracket on the shell, rubber foot."""
    out = np.array([np.cos(angle), np.sin(angle), 0.0])
    centre = np.array([where[0], where[1], 0.0])
    bend = [
        (0.03, where[2] - 0.1), (0.03, FLOOR + 0.34), (0.035, FLOOR + 0.28), (0.06, FLOOR + 0.16),
        (0.06, FLOOR + 0.02),
    ]  # fmt: skip
    points = [centre + out * (radius + o) + [0, 0, z] for o, z in bend]
    leg = m.sweep(m.spline(points, 6), m.circle(0.0085, 12))
    bracket = s.block((-0.006, -0.026, -0.035), (0.045, 0.026, 0.035), 0.006).moved(
        m.frame(centre + out * radius + [0, 0, where[2] - 0.22], (0, 0, 1), out)
    )
    return leg, bracket, tb.rubber_foot(points[-1] - [0, 0, 0.02], 0.022)


def tom_mount(toms: list) -> list[Mesh]:
    """A post on the bass drum with an arm to each tom's bracket."""
    foot = np.array([0.0, 0.2, FLOOR + 0.75])
    top = foot + [0.0, 0.0, 0.27]
    pieces = [
        tb.tube(np.linspace(foot - [0, 0, 0.02], top, 5), 0.019, 0.015, 18),
        s.block((-0.05, 0.14, FLOOR + 0.748), (0.05, 0.26, FLOOR + 0.785), 0.008),
        tb.collar(foot + [0, 0, 0.14], 0.028, 0.05),
        tb.wing_nut(foot + [0, 0.026, 0.14], (0, 1, 0), 0.06),
    ]
    for k, (where, normal, drum) in enumerate(toms):
        n = normal / np.linalg.norm(normal)
        middle = np.asarray(where) - 0.5 * drum.depth * n
        out = foot - middle
        out -= (out @ n) * n
        out /= np.linalg.norm(out)
        end = middle + out * (drum.radius + 0.012)
        knee = np.array([foot[0], foot[1], top[2] - 0.03 - 0.05 * k])
        pieces += [
            tb.rod(knee, end, 0.012, 14),
            tb.collar(knee, 0.027, 0.04),
            s.block((-0.02, -0.035, -0.04), (0.014, 0.035, 0.04), 0.006).moved(m.frame(end, n, out)),
            tb.wing_nut(end + 0.04 * n, n, 0.045),
        ]
    return pieces


def snare_stand(where: tuple, normal: np.ndarray, drum: d.Drum) -> tuple[Mesh, Mesh]:
    """Basket of three arms under the snare on a tripod."""
    n = normal / np.linalg.norm(normal)
    low = np.asarray(where) - (drum.depth + 0.03) * n
    hub = low - 0.1 * n
    foot = np.array([hub[0], hub[1], FLOOR])
    legs, feet = tb.tripod(foot, 0.24, 0.3, np.radians(80.0))
    metal, rubber = [legs, *_column(foot, hub), tb.collar(hub, 0.034, 0.05, n)], [feet]
    at = m.frame(low, n, (1.0, 0.0, 0.0))
    for angle in np.radians([40.0, 160.0, 280.0]):
        out = at[:3, 0] * np.cos(angle) + at[:3, 1] * np.sin(angle)
        tip = low + out * (drum.radius + 0.046)
        curve = m.spline(
            [hub, hub + 0.1 * out + 0.03 * n, low + 0.2 * out - 0.01 * n, tip + 0.0 * n, tip + 0.05 * n], 5
        )
        metal.append(m.sweep(curve, m.circle(0.008, 10)))
        rubber.append(tb.rod(tip + 0.02 * n, tip + 0.055 * n, 0.0125, 12))
    return m.join(metal), m.join(rubber)


def stick() -> Mesh:
    """A drum stick along z from the butt, lying on its axis."""
    outline = [(0.0, 0.0), (0.008, 0.0), (0.0095, 0.004), (0.0095, 0.3), (0.005, 0.48), (0.0045, 0.49), (0.0065, 0.5),
               (0.0065, 0.512), (0.0, 0.518)]  # fmt: skip
    return m.revolve(outline, 14)
