"""The scene "chair": an upholstered armchair with carved cabriole legs; the backrest rocks."""

from dataclasses import replace

import numpy as np

from .. import meshes as m
from ..patterns.solid import of_grid
from ..scene import AreaLight, Gradient, Part, Scene, part
from ..shapes import sheet as c
from ..shapes.scatter import both, copies
from ..shapes.sheet import edged, leaf, puff, puff_points, rounded, shell, volute
from . import chair_surfaces as paint

GROUND = -1.06
RAIL = (-0.225, -0.065)  # lower and upper edge of the seat's wooden rail
SEAT_X = 0.06  # the seat's middle
BACK_Z = 0.645  # the backrest's middle
SEAT = c.Outline(0.56, 0.56, 4.0, taper=0.10)
BACK = c.Outline(0.455, 0.395, 3.2, shoulder=0.06, crest=0.05)
_NAIL = [(0.0, -0.3), (0.9, -0.3), (1.0, -0.1), (0.92, 0.2), (0.7, 0.48), (0.38, 0.66), (0.0, 0.72)]
_FOOT = [
    (0.0, 0.0), (0.03, 0.0), (0.046, 0.012), (0.052, 0.03), (0.046, 0.05), (0.036, 0.062), (0.04, 0.07),
    (0.036, 0.08), (0.0, 0.085),
]  # fmt: skip


_LOWER = m.frame((0.0, 0.0, -0.03), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))  # so that no camera cuts the crest off


def build() -> Scene:
    return Scene(
        name="chair",
        parts=tuple(
            replace(part, mesh=part.mesh.moved(_LOWER)) for part in (*_legs(), *_seat(), *_back(), *_arms())
        ),
        lights=(AreaLight((3.4, -2.2, 3.6), 3.0, 190.0, (1.0, 0.95, 0.87)),),
        sky=Gradient(((0.3, 0.27, 0.24), (0.52, 0.5, 0.49), (0.85, 0.93, 1.08))),
    )


def _on_seat(points: np.ndarray, z: float = RAIL[1]) -> np.ndarray:
    """Plane points [..., 2] of the seat's outline in space, level at height z."""
    return np.stack([points[..., 0] + SEAT_X, points[..., 1], np.full(points.shape[:-1], z)], -1)


def _on_back(points: np.ndarray) -> np.ndarray:
    """Plane points (across, up) [..., 2] of the backrest in space: it leans back and is hollow for the sitter."""
    y, h = points[..., 0], points[..., 1]
    x = -0.535 - 0.21 * h - 0.09 * h**2 + 0.30 * y**2
    return np.stack([x, y, BACK_Z + h], -1)


def _legs() -> list[Part]:
    fore = m.spline(
        [(0.50, 0.485, -0.12), (0.535, 0.515, -0.26), (0.56, 0.54, -0.36), (0.535, 0.515, -0.56), (0.505, 0.49, -0.76),
         (0.51, 0.495, -0.88), (0.545, 0.53, -0.975), (0.562, 0.545, -1.0)], 14)  # fmt: skip
    hind = m.spline(
        [(-0.41, 0.385, -0.12), (-0.425, 0.40, -0.3), (-0.46, 0.42, -0.6), (-0.56, 0.455, -1.01)], 26
    )
    t = np.linspace(0.0, 1.0, len(fore))
    thick = np.interp(
        t, [0, 0.15, 0.3, 0.42, 0.62, 0.8, 0.88, 0.95, 1], [0.9, 1.0, 1.02, 0.86, 0.62, 0.44, 0.44, 0.56, 0.5]
    )
    section = c.bead_section(0.155, 0.155, 8, 0.16)
    corner = (1.0, 1.0, 0.0)  # an edge of the section looks outwards
    front = m.sweep(fore, section, thick, corner)
    rear = m.sweep(hind, section, np.linspace(0.72, 0.4, len(hind)), corner)
    knee = leaf(0.3, 0.17, 0.02, -0.01).moved(
        m.frame((0.583, 0.563, -0.235), (0.74, 0.67, -0.22), (0.6, -0.75, 0.0))
    )
    feet = [m.revolve(_FOOT, 28).moved(m.shift(p[-1] * [1, 1, 0] + [0, 0, GROUND])) for p in (fore, hind)]
    legs = m.join([front, rear])
    return [
        part("legs", both(legs), paint.legs()),
        part("knees", both(knee), paint.gilt("knees", 3)),
        part("feet", both(m.join(feet)), paint.brass("feet")),
    ]


def _dome(radius: float, segments: int) -> m.Mesh:
    """The head of an upholstery nail, its foot just below z = 0."""
    return m.revolve([(radius * r, radius * z) for r, z in _NAIL], segments, 180.0)


def _nails(points: np.ndarray, directions: np.ndarray, radius: float) -> m.Mesh:
    dome = _dome(radius, 10)
    return copies(dome, points, directions, np.random.default_rng(5), (0.95, 1.05))


def _level(rim: np.ndarray, z: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return c.frames_on(lambda points: _on_seat(points, z), rim)


def _seat() -> list[Part]:
    low, high = RAIL
    rail = c.moulding(
        *_level(SEAT.rim(220, -0.015), (low + high) / 2), c.bead_section(0.075, high - low, 6, 0.2)
    )
    flat, share = SEAT.disc(100)
    buttons = c.diamonds(5, 4, (0.19, 0.25), (0.0, 0.0))
    pulled = c.tufts(flat, buttons, 0.05, 0.045, 0.022)
    above = 0.165 * rounded(share, 2.7) - pulled * rounded(share, 6.0)
    below = 0.02 * rounded(share, 8.0)
    middle = _on_seat(flat, high)
    texels = of_grid(puff_points(middle, above, below), 768, 448)
    cord = c.moulding(*_level(SEAT.rim(320, 0.002), high + 0.006), m.circle(0.017, 12))
    gimp = c.moulding(*_level(SEAT.rim(320, 0.026), low + 0.004), m.circle(0.015, 12))
    spots, outward, _ = _level(SEAT.rim(118, 0.0225), high - 0.03)
    on_top = np.array(
        [above[np.unravel_index(np.argmin(np.linalg.norm(flat - b, axis=-1)), share.shape)] for b in buttons]
    )
    knobs = _on_seat(buttons) + np.column_stack([0 * on_top, 0 * on_top, on_top + 0.004])
    front = SEAT.radius(np.zeros(1))[0] + SEAT_X + 0.016
    apron = shell(0.115, 0.022, 9, np.radians(230.0)).moved(
        m.frame((front, 0.0, (low + high) / 2 - 0.015), (1, 0, 0), (0, 1, 0))
    )
    return [
        part("seat_rail", rail, paint.rail("seat_rail", 4.0, 1)),
        part("seat_shell", apron, paint.gilt("seat_shell", 1)),
        part("seat_cushion", puff(middle, above, below), paint.brocade("seat_cushion", texels, 0, 1, pulled)),
        part("seat_cord", cord, paint.cord("seat_cord", 130)),
        part("seat_gimp", gimp, paint.cord("seat_gimp", 90)),
        part("seat_nails", _nails(spots, outward, 0.0125), paint.brass("seat_nails")),
        part("seat_buttons", _nails(knobs, np.tile([0.0, 0.0, 1.0], (len(knobs), 1)), 0.021), paint.button()),
        part("seat_fringe", _fringe(low), paint.fringe()),
    ]  # fmt: skip


def _fringe(top: float) -> m.Mesh:
    """Threads below the rail, every tenth a tassel; none where a leg stands."""
    rng = np.random.default_rng(8)
    feet = np.array([[sx, sy * w] for sx, w in ((0.535, 0.515), (-0.425, 0.40)) for sy in (1, -1)])
    tassel = m.revolve(
        [
            (0.0, -0.115),
            (0.021, -0.115),
            (0.017, -0.06),
            (0.011, -0.045),
            (0.017, -0.03),
            (0.013, -0.014),
            (0.0, -0.008),
        ],
        12,
    )
    made = []
    for k, spot in enumerate(_on_seat(SEAT.rim(330, 0.026), top)):
        if np.linalg.norm(feet - spot[:2], axis=1).min() < 0.125:
            continue
        if k % 11 == 0:
            made.append(tassel.moved(m.shift(spot)))
            continue
        sway = rng.normal(0.0, 0.004, (4, 3)) * np.array([0.0, 0.3, 0.7, 1.0])[:, None]
        path = spot + sway + np.array([0.0, -0.025, -0.05, -0.072])[:, None] * [0.0, 0.0, 1.0]
        made.append(m.sweep(path, m.circle(0.0062, 6), np.array([0.9, 1.0, 1.0, 1.15]), (1.0, 0.3, 0.0)))
    return m.join(made)


def _back() -> list[Part]:
    frame = c.moulding(*c.frames_on(_on_back, BACK.rim(240, 0.042)), c.bead_section(0.098, 0.09, 6, 0.22))
    flat, share = BACK.disc(96)
    buttons = c.diamonds(5, 4, (0.17, 0.20), (0.0, 0.0))[:, ::-1] + [0.0, 0.01]
    pulled = c.tufts(flat, buttons, 0.045, 0.04, 0.02)
    above = 0.10 * rounded(share, 2.7) - pulled * rounded(share, 6.0)
    below = 0.045 * rounded(share, 3.5)
    middle = _on_back(flat)
    texels = of_grid(puff_points(middle, above, below), 768, 448)
    lifted, _ = _raised(BACK.rim(300, -0.012), 0.038)
    cord = c.moulding(lifted, *c.frames_on(_on_back, BACK.rim(300, -0.012))[1:], m.circle(0.0155, 12))
    nails, facing = _raised(BACK.rim(96, 0.021), 0.04)
    nearest = [np.unravel_index(np.argmin(np.linalg.norm(flat - b, axis=-1)), share.shape) for b in buttons]
    spots, outward = _raised(buttons, np.array([above[k] for k in nearest]) + 0.003)
    y, z = 0.425, BACK_Z - 0.27
    stile = m.spline(
        [
            (-0.44, 0.39, -0.2),
            (-0.455, 0.395, -0.05),
            (-0.448, 0.42, 0.15),
            _on_back(np.array([y + 0.03, z - BACK_Z])),
        ],
        18,
    )
    stiles = m.sweep(
        stile, c.bead_section(0.095, 0.095, 6, 0.2), np.linspace(1.0, 0.86, len(stile)), (1.0, 0.0, 0.0)
    )
    return [
        part("back_frame", frame, paint.rail("back_frame", 2.9, 4)),
        part("back_stiles", both(stiles), paint.stiles()),
        part("back_pad", puff(middle, above, below), paint.brocade("back_pad", texels, 1, 2, pulled)),
        part("back_cord", cord, paint.cord("back_cord", 100)),
        part("back_nails", _nails(nails, facing, 0.0125), paint.brass("back_nails")),
        part("back_buttons", _nails(spots, outward, 0.019), paint.button()),
        part("back_crest", _crest(), paint.gilt("back_crest", 2)),
    ]


def _raised(points: np.ndarray, by: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Plane points laid on the backrest and lifted forwards: places and normals."""
    place, _, normal = c.frames_on(_on_back, points)
    lifted = place + np.broadcast_to(by, len(place))[:, None] * normal
    return lifted, normal


def _crest() -> m.Mesh:
    top = BACK.radius(np.array([np.pi / 2]))[0] + 0.045
    (place,), (normal,) = _raised(np.array([[0.0, top]]), 0.043)
    fan = shell(0.10, 0.022, 9, np.radians(250.0)).moved(m.frame(place, normal, (0, 1, 0)))
    sides = []
    for angle in (np.radians(70.0), np.radians(45.0)):
        reach = BACK.radius(np.array([angle]))[0] + 0.045
        (place,), (normal,) = _raised(reach * np.array([[np.cos(angle), np.sin(angle)]]), 0.04)
        along = np.array([0.0, np.sin(angle), -np.cos(angle)])  # the leaf runs down the rail
        sides.append(leaf(0.17, 0.085, 0.018).moved(m.frame(place, normal, np.cross(along, normal))))
    return m.join([fan, both(m.join(sides))])


def _arms() -> list[Part]:
    start = _on_back(np.array([0.49, -0.10]))
    scroll = volute((0.40, 0.385), 0.075, 0.022, 1.35, 44)
    along: list[m.Vector] = [start, (-0.36, 0.53, 0.505), (-0.1, 0.60, 0.475), (0.2, 0.635, 0.455)]
    curl = np.column_stack([scroll[:, 0], np.full(44, 0.635), scroll[:, 1]])
    path = m.spline([*along, *curl[::3], curl[-1]], 8)
    t = np.linspace(0.0, 1.0, len(path))
    section = c.bead_section(0.082, 0.088, 6, 0.2)
    arm = m.sweep(path, section, np.interp(t, [0, 0.5, 0.62, 1.0], [0.8, 1.0, 0.85, 0.42]), (0.0, 0.0, 1.0))
    eye = _dome(0.03, 20)
    eyes = [eye.moved(m.frame((0.40, 0.635 + s * 0.02, 0.385), (0.0, s, 0.0))) for s in (1.0, -1.0)]
    post = m.spline(
        [
            (0.20, 0.545, -0.15),
            (0.185, 0.60, -0.02),
            (0.20, 0.655, 0.14),
            (0.27, 0.655, 0.28),
            (0.345, 0.635, 0.41),
        ],
        16,
    )
    thick = np.interp(np.linspace(0, 1, len(post)), [0, 0.3, 0.6, 1], [1.0, 0.95, 0.75, 0.62])
    support = m.sweep(post, section, thick, (1.0, 0.0, 0.0))
    pad, texels = _arm_pad(np.array(along[1:]))
    return [
        part("arm_wood", both(m.join([arm, support])), paint.rail("arm_wood", 1.6, 7)),
        part("arm_eyes", both(m.join(eyes)), paint.brass("arm_eyes")),
        part("arm_pads", both(pad), paint.brocade("arm_pads", texels, 0, 3)),
    ]


def _arm_pad(path: np.ndarray) -> tuple[m.Mesh, np.ndarray]:
    line = m.spline(list(path), 30)[8:74]
    along, across = edged(len(line), 0.7), edged(40, 0.6)
    even = np.linspace(-1.0, 1.0, len(line))
    spread = np.column_stack([np.interp(along, even, line[:, k]) for k in range(3)])
    width = 0.066 * rounded(along, 4.0)
    middle = (
        spread[:, None]
        + [0.0, 0.0, 0.034]
        - np.array([0.0, 1.0, 0.0]) * (width[:, None] * across[None])[..., None]
    )
    edge = rounded(along, 3.0)[:, None] * rounded(across, 2.4)[None]
    above, below = 0.055 * edge, 0.02 * edge
    up = np.array([0.0, 0.0, 1.0])
    return puff(middle, above, below, up), of_grid(puff_points(middle, above, below, up), 384, 192)
