"""The hull of the scene "ship": skin, wales, bulwarks, decks, stern, head, gun ports."""

from __future__ import annotations

import numpy as np

from .. import meshes as m
from ..scene import Part, Surface
from ..shapes import hull as lines
from ..shapes import joinery as j
from ..shapes.patch import both, box, patch, slab
from . import ship_surfaces as paint
from .ship_plan import BULWARKS, HULL, LEVELS, LINING, deck_z

_WALL = 0.011  # thickness of the bulwarks
_BROWN, _GREEN = (0.36, 0.19, 0.11), (0.17, 0.2, 0.16)


def parts() -> tuple[Part, ...]:
    """All parts of the hull."""
    return (*_hull(), *_bulwarks(), *_decks(), *_stern(), *_head(), *_guns())


def rigid(name: str, mesh: m.Mesh, surface: Surface) -> Part:
    """A part that goes along with the ship."""
    return Part(name, mesh, surface, np.ones(len(mesh.vertices)))


def _hull() -> tuple[Part, ...]:
    """Skin, keel with stem and sternpost, wales."""
    s = np.linspace(0.0, 1.0, 24)
    stem = HULL.side(np.ones(24), s)
    stern = HULL.side(np.zeros(8), np.linspace(1.0, 0.0, 8)) * [1.0, 0.0, 1.0]
    spine = m.spline([*stern[:-1:2], *np.linspace(stern[-1], stem[0], 6), *stem[3::3]], 8)
    keel = m.sweep(spine, m.rounded_rectangle(0.045, 0.03, 0.006), up=(1.0, 0.0, 0.0))
    heavy, light = m.rounded_rectangle(0.024, 0.016, 0.005), m.rounded_rectangle(0.013, 0.012, 0.004)
    wales = [lines.strip(HULL, (0.0, 0.995), h, heavy) for h in (-0.085, -0.125)]
    wales += [lines.strip(HULL, (0.0, 0.995), h, light) for h in (-0.028, 0.0)]
    return (
        rigid("hull", lines.planking(HULL), paint.hull()),
        rigid("keel", keel, paint.oak()),
        rigid("wales", m.join(wales), paint.wale()),
    )


def _bulwarks() -> tuple[Part, ...]:
    """Painted sides above the sheer, each with its rail."""
    made, rails = {}, []
    for name, (ends, low, high) in BULWARKS.items():
        made[name] = lines.bulwark(HULL, ends, low, high, _WALL, LINING[name])
        rails.append(lines.strip(HULL, ends, high, m.rounded_rectangle(0.012, 0.022, 0.004), -0.005, 50))
    return (
        rigid("waist", made["waist"], paint.upper_works("waist", _GREEN, 41)),
        rigid("forecastle", made["forecastle"], paint.upper_works("forecastle", _BROWN, 43)),
        rigid("quarterdeck", made["quarterdeck"], paint.upper_works("quarterdeck", _BROWN, 45)),
        rigid("poop", made["poop"], paint.upper_works("poop", _GREEN, 47)),
        rigid("rails", m.join(rails), paint.gilt("rails")),
    )


def _decks() -> tuple[Part, ...]:
    """Decks, the bulkheads between their levels with doors and windows, and the rails along their breaks."""
    decks, walls, frames, panes, balusters, rails = [], [], [], [], [], []
    for ends, height in LEVELS.values():
        made = lines.deck(HULL, ends, height, 0.008)
        decks.append(m.Mesh(made.vertices, made.triangles, made.uv / 0.5))
    breaks = (
        ("quarterdeck", "waist", 1, 1.0),
        ("poop", "quarterdeck", 1, 1.0),
        ("forecastle", "waist", 0, -1.0),
    )
    for high, low, end, facing in breaks:
        u = LEVELS[high][0][end]
        x, top, foot = float(HULL.side(u, 1.0)[0]), deck_z(high, u), deck_z(low, u) - 0.006
        half = float(HULL.breadth(np.array(u), top)) - 0.008
        wall = slab((x - 0.006, -half, foot), (x + 0.006, half, top + 0.012))
        walls.append(wall)
        for y, width, tall, bars in (
            (-0.55, 0.05, 0.5, (3, 2)),
            (0.55, 0.05, 0.5, (3, 2)),
            (0.0, 0.06, 0.78, (2, 1)),
        ):
            z = foot + (top - foot) * (0.53 if y else 0.44)
            at = j.frame_on((x + 0.006 * facing, y * half, z), (facing, 0.0, 0.0))
            frame, pane = j.window(at, width, (top - foot) * tall, bars)
            frames.append(frame)
            panes.append(pane)
        edge = np.linspace([x, -half, top + 0.012], [x, half, top + 0.012], 9)
        turned, rail = j.balustrade(edge, 0.048, int(half / 0.011), 0.013)
        balusters.append(turned)
        rails.append(rail)
    return (
        rigid("decks", m.join(decks), paint.deck()),
        rigid("bulkheads", m.join(walls), paint.bulkhead()),
        rigid("doors", m.join(frames), paint.gilt("doors")),
        rigid("door_panes", m.join(panes), paint.glass("door_panes", (0.22, 0.2, 0.16), 61)),
        rigid("balusters", m.join([*balusters, *rails]), paint.turned()),
    )


def _transom_point(y: float, z: float) -> np.ndarray:
    """On the stern's face, a hair outside it."""
    s = HULL.level(np.array(0.0), z)
    edge = HULL.side(np.array(0.0), s)
    return np.array([edge[0] - 0.1 * abs(edge[1]) * (1.0 - (y / edge[1]) ** 2) - 0.002, y, z])


def _stern() -> tuple[Part, ...]:
    """Transom with two rows of windows, gallery, carved crown, three lanterns, rudder."""
    top = float(HULL.level(np.array(0.0), HULL.sheer(np.array(0.0)) + BULWARKS["poop"][2]))
    frames, panes, carving = [], [], []
    for z, count, spread in ((-0.06, 5, 0.048), (0.035, 5, 0.046)):
        for k in range(count):
            at = j.frame_on(_transom_point((k - (count - 1) / 2) * spread, z), (-1.0, 0.0, 0.1))
            frame, pane = j.window(at, 0.036, 0.056, (2, 3))
            frames.append(frame)
            panes.append(pane)
    for z in (-0.105, -0.016, 0.074):  # mouldings across
        half = float(HULL.breadth(np.array(0.0), z))
        path = np.array([_transom_point(y, z) for y in np.linspace(half, -half, 15)])
        carving.append(m.sweep(path, m.rounded_rectangle(0.012, 0.018, 0.004)))
    half = float(HULL.breadth(np.array(0.0), 0.1))
    arch = np.array(
        [[0.0, y, 0.1 + 0.075 * np.sqrt(1 - (y / half) ** 2)] for y in np.linspace(half, -half, 31)]
    )
    arch[:, 0] = _transom_point(0.0, 0.1)[0] - 0.004
    carving.append(m.sweep(arch, m.rounded_rectangle(0.022, 0.02, 0.006)))
    crown = np.stack([arch * [1, 1, 0] + [0.004, 0, 0.09], arch + [0.004, 0, 0]])
    carving.append(patch(crown))
    gallery = [
        _transom_point(y, -0.014) - [0.045 - 0.6 * y * y, 0, 0] for y in np.linspace(0.135, -0.135, 17)
    ]
    floor = np.stack(
        [np.array(gallery), np.array([_transom_point(p[1], -0.014) + [0.01, 0, 0] for p in gallery])]
    )
    turned, rail = j.balustrade(np.array(gallery) + [0.004, 0, 0], 0.04, 22, 0.012)
    slab_top, slab_foot = patch(floor, flip=True), patch(floor - [0, 0, 0.01])
    lanterns = [j.lantern(m.frame((x, y, z), (-0.12, 0, 1)), s) for x, y, z, s in
                ((-0.845, 0.0, 0.175, 0.075), (-0.83, -0.1, 0.145, 0.06), (-0.83, 0.1, 0.145, 0.06))]  # fmt: skip
    blade = m.sweep(
        np.linspace([-0.735, 0, -0.53], [-0.795, 0, -0.12], 12), m.rounded_rectangle(0.07, 0.022, 0.008),
        np.linspace(1.25, 0.75, 12), up=(1.0, 0.0, 0.0),
    )  # fmt: skip
    return (
        rigid("transom", lines.transom(HULL, top), paint.upper_works("transom", _BROWN, 49)),
        rigid("stern_windows", m.join(frames), paint.gilt("stern_windows")),
        rigid("stern_panes", m.join(panes), paint.glass("stern_panes", (0.3, 0.36, 0.38), 62)),
        rigid("carving", m.join([*carving, slab_top, slab_foot, turned, rail]), paint.gilt("carving")),
        rigid("lanterns", m.join([metal for metal, _ in lanterns]), paint.gilt("lanterns")),
        rigid(
            "lantern_panes",
            m.join([pane for _, pane in lanterns]),
            paint.glass("lamp", (0.9, 0.72, 0.35), 63),
        ),
        rigid("rudder", blade, paint.wale()),
    )


def _head() -> tuple[Part, ...]:
    """Beakhead with its knee, head rails and gilded figure."""
    knee = m.spline(
        [(0.60, 0, -0.30), (0.67, 0, -0.22), (0.75, 0, -0.145), (0.84, 0, -0.085), (0.885, 0, -0.05)], 8
    )
    wood = [m.sweep(knee, m.rounded_rectangle(0.075, 0.026, 0.008), np.linspace(1.25, 0.5, len(knee)))]
    for low, high, size in ((-0.115, -0.078, 1.0), (-0.165, -0.125, 0.8), (-0.06, -0.04, 1.0)):
        start = HULL.at(0.60, low + 0.02, 0.004)
        rail = m.spline(
            [start, (0.72, -0.055, low - 0.01), (0.80, -0.03, low + 0.012), (0.868, -0.008, high)], 8
        )
        wood.append(both(m.sweep(rail, m.rounded_rectangle(0.014, 0.012, 0.004), size)))
    for x in (0.68, 0.735, 0.785):  # head timbers between the rails
        t = (0.868 - x) / 0.27
        rib = m.spline([(x, -0.004, -0.2 + 0.35 * (x - 0.68)), (x, -0.04 * t - 0.02, -0.15 + 0.3 * (x - 0.68)),
                        (x, -0.075 * t - 0.012, -0.05)], 6)  # fmt: skip
        wood.append(both(m.sweep(rib, m.rounded_rectangle(0.014, 0.01, 0.003))))
    body = m.spline(
        [(0.865, 0, -0.10), (0.88, 0, -0.07), (0.90, 0, -0.03), (0.915, 0, 0.0), (0.93, 0, 0.03)], 8
    )
    girth = np.interp(
        np.linspace(0, 1, len(body)), (0, 0.25, 0.5, 0.68, 0.78, 0.88, 0.95, 1), (9, 17, 15, 19, 9, 13, 10, 2)
    )
    arm = m.spline([(0.912, -0.016, 0.0), (0.925, -0.03, -0.018), (0.95, -0.022, -0.012)], 6)
    figure = [
        m.sweep(body, m.circle(0.001, 14), girth, up=(1.0, 0.0, 0.0)),
        both(m.sweep(arm, m.circle(0.006, 7))),
    ]
    return rigid("head_rails", m.join(wood), paint.wale()), rigid("figurehead", m.join(figure), paint.gilt())


def _port_frames() -> list[np.ndarray]:
    """Starboard gun ports: [4, 4] with z outwards and x up."""
    spots = [(x, -0.055) for x in np.linspace(-0.62, 0.46, 10)]
    spots += [(x, 0.032) for x in (-0.62, -0.53, -0.44, -0.35, -0.26)] + [(0.36, 0.035), (0.46, 0.035)]
    frames = []
    for x, up in spots:
        u = HULL.station(x, -0.15)
        z = float(HULL.sheer(np.array(u))) + up
        s = HULL.level(np.array(u), z)
        along = HULL.side(np.array(u + 0.01), s) - HULL.side(np.array(u - 0.01), s)
        rise = HULL.side(np.array(u), s + 0.03) - HULL.side(np.array(u), s - 0.03)
        frames.append(m.frame(HULL.side(np.array(u), s), np.cross(along, rise), rise))
    return frames


def _guns() -> tuple[Part, ...]:
    """Gun ports with frames and raised lids, and the guns run out of them."""
    lids, holes, barrels = [], [], []
    for at in _port_frames():
        lids.append(j.window(at, 0.044, 0.042, (1, 1))[0])
        hole = np.eye(4)
        hole[2, 3] = -0.001
        holes.append(box((0.034, 0.036, 0.006)).moved(at @ hole))
        lift = np.eye(4)
        lift[:3, :3] = np.array([[0.35, 0, -0.94], [0, 1, 0], [0.94, 0, 0.35]])
        lift[:3, 3] = (0.024, 0.0, 0.006)
        out = np.eye(4)
        out[:3, 3] = (0.02, 0.0, 0.0)
        lids.append(box((0.038, 0.042, 0.006), tile=0.06).moved(at @ lift @ out))
        level = m.frame(at[:3, 3], at[:3, 2] * [1, 1, 0.0])
        back = np.eye(4)
        back[2, 3] = -0.05
        barrels.append(j.cannon(level @ back, 0.095))
    return (
        rigid("ports", both(m.join(lids)), paint.port()),
        rigid("port_holes", both(m.join(holes)), paint.dark()),
        rigid("guns", both(m.join(barrels)), paint.iron()),
    )
