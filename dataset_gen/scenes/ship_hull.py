"""The hull of the scene "ship": skin, wales, bulwarks, decks, stern, head, gun ports."""

import numpy as np

from .. import meshes as m
from ..scene import Part, part
from ..shapes import hull as lines
from ..shapes import vessel as j
from ..shapes.scatter import both, box, patch, slab, tiled
from . import ship_surfaces as paint
from .ship_fittings import BULWARKS, HULL, LEVELS, LINING, deck_z

_WALL = 0.011  # thickness of the bulwarks
_BROWN, _GREEN = (0.36, 0.19, 0.11), (0.17, 0.2, 0.16)

# Where a deck ends above a lower one: the higher, the lower, which end of the higher, where its wall looks to.
_BREAKS = (
    ("quarterdeck", "waist", 1, 1.0),
    ("poop", "quarterdeck", 1, 1.0),
    ("forecastle", "waist", 0, -1.0),
)
# Openings in such a wall: place across as a share of the half-breadth, width, share of the height, bars.
_OPENINGS = ((-0.55, 0.05, 0.5, (3, 2)), (0.55, 0.05, 0.5, (3, 2)), (0.0, 0.06, 0.78, (2, 1)))


def parts() -> tuple[Part, ...]:
    return (*_hull(), *_bulwarks(), *_decks(), *_stern(), *_head(), *_guns())


def _hull() -> tuple[Part, ...]:
    s = np.linspace(0.0, 1.0, 24)
    stem = HULL.side(np.ones(24), s)
    stern = HULL.side(np.zeros(8), np.linspace(1.0, 0.0, 8)) * [1.0, 0.0, 1.0]
    spine = m.spline([*stern[:-1:2], *np.linspace(stern[-1], stem[0], 6), *stem[3::3]], 8)
    keel = m.sweep(spine, m.rounded_rectangle(0.045, 0.03, 0.006), up=(1.0, 0.0, 0.0))
    heavy, light = m.rounded_rectangle(0.024, 0.016, 0.005), m.rounded_rectangle(0.013, 0.012, 0.004)
    wales = [lines.strip(HULL, (0.0, 0.995), h, heavy) for h in (-0.085, -0.125)]
    wales += [lines.strip(HULL, (0.0, 0.995), h, light) for h in (-0.028, 0.0)]
    return (
        part("hull", lines.planking(HULL), paint.hull()),
        part("keel", keel, paint.oak()),
        part("wales", m.join(wales), paint.wale()),
    )


def _bulwarks() -> tuple[Part, ...]:
    made, rails = {}, []
    for name, (ends, low, high) in BULWARKS.items():
        made[name] = lines.bulwark(HULL, ends, low, high, _WALL, LINING[name])
        rails.append(lines.strip(HULL, ends, high, m.rounded_rectangle(0.012, 0.022, 0.004), -0.005, 50))
    return (
        part("waist", made["waist"], paint.upper_works("waist", _GREEN, 41)),
        part("forecastle", made["forecastle"], paint.upper_works("forecastle", _BROWN, 43)),
        part("quarterdeck", made["quarterdeck"], paint.upper_works("quarterdeck", _BROWN, 45)),
        part("poop", made["poop"], paint.upper_works("poop", _GREEN, 47)),
        part("rails", m.join(rails), paint.gilt("rails")),
    )


def _decks() -> tuple[Part, ...]:
    sheets = [lines.deck(HULL, ends, height, 0.008) for ends, height in LEVELS.values()]
    decks = tiled(m.join(sheets), 2.0, 2.0)  # the picture is half a unit long
    walls, openings, tops = zip(*(_bulkhead(*which) for which in _BREAKS), strict=True)
    frames, panes = zip(*(piece for wall in openings for piece in wall), strict=True)
    return (
        part("decks", decks, paint.deck()),
        part("bulkheads", m.join(walls), paint.bulkhead()),
        part("doors", m.join(frames), paint.gilt("doors")),
        part("door_panes", m.join(panes), paint.glass("door_panes", (0.22, 0.2, 0.16), 61)),
        part("balusters", m.join([piece for top in tops for piece in top]), paint.turned()),
    )


def _bulkhead(
    high: str, low: str, end: int, facing: float
) -> tuple[m.Mesh, list[tuple[m.Mesh, m.Mesh]], tuple[m.Mesh, m.Mesh]]:
    u = np.array(LEVELS[high][0][end])
    x, top, foot = (
        float(HULL.side(u, np.array(1.0))[0]),
        deck_z(high, float(u)),
        deck_z(low, float(u)) - 0.006,
    )
    half, tall = float(HULL.breadth(u, top)) - 0.008, top - foot
    openings = []
    for place, width, share, bars in _OPENINGS:
        z = foot + tall * (0.53 if place else 0.44)
        at = m.frame((x + 0.006 * facing, place * half, z), (facing, 0.0, 0.0))
        openings.append(j.window(at, width, tall * share, bars))
    edge = np.linspace([x, -half, top + 0.012], [x, half, top + 0.012], 9)
    wall = slab((x - 0.006, -half, foot), (x + 0.006, half, top + 0.012))
    return wall, openings, j.balustrade(edge, 0.048, int(half / 0.011), 0.013)


def _transom_point(y: float, z: float) -> np.ndarray:
    """Return a point just outside the stern's face."""
    s = HULL.level(np.array(0.0), z)
    edge = HULL.side(np.array(0.0), s)
    return np.array([edge[0] - 0.1 * abs(edge[1]) * (1.0 - (y / edge[1]) ** 2) - 0.002, y, z])


def _stern() -> tuple[Part, ...]:
    top = float(HULL.level(np.array(0.0), HULL.sheer(np.array(0.0)) + BULWARKS["poop"][2]))
    frames, panes = zip(*(_stern_window(k, z) for z in (-0.06, 0.035) for k in range(-2, 3)), strict=True)
    # y, height of the foot, size; they stand on the crown
    metal, lamps = zip(
        *(_lantern(*spot) for spot in ((0.0, 0.178, 0.075), (-0.07, 0.153, 0.06), (0.07, 0.153, 0.06))),
        strict=True,
    )
    rudder = m.sweep(
        np.linspace([-0.735, 0.0, -0.53], [-0.795, 0.0, -0.12], 12), m.rounded_rectangle(0.07, 0.022, 0.008),
        np.linspace(1.25, 0.75, 12), up=(1.0, 0.0, 0.0),
    )  # fmt: skip
    return (
        part("transom", lines.transom(HULL, top), paint.transom()),
        part("stern_windows", m.join(frames), paint.gilt("stern_windows")),
        part("stern_panes", m.join(panes), paint.glass("stern_panes", (0.3, 0.36, 0.38), 62)),
        part("carving", m.join([*_mouldings(), *_crown(), *_gallery()]), paint.gilt("carving")),
        part("lanterns", m.join(metal), paint.gilt("lanterns")),
        part("lantern_panes", m.join(lamps), paint.glass("lamp", (0.9, 0.72, 0.35), 63)),
        part("rudder", rudder, paint.wale()),
    )


def _stern_window(number: int, z: float) -> tuple[m.Mesh, m.Mesh]:
    at = m.frame(_transom_point(0.046 * number, z), (-1.0, 0.0, 0.1))
    return j.window(at, 0.034, 0.056, (2, 3))


def _lantern(y: float, foot: float, size: float) -> tuple[m.Mesh, m.Mesh]:
    """A stern lantern on its post: (metal, glass)."""
    x = _transom_point(0.0, 0.1)[0] - 0.002
    metal, glass = j.lantern(m.frame((x, y, foot), (-0.12, 0.0, 1.0)), size)
    post = m.sweep(
        np.linspace([x, y, foot - 0.04], [x, y, foot + 0.004], 4), m.circle(0.006, 8), up=(1.0, 0.0, 0.0)
    )
    return m.join([metal, post]), glass


def _mouldings() -> list[m.Mesh]:
    made = []
    for z in (-0.105, -0.016, 0.074):
        half = float(HULL.breadth(np.array(0.0), z))
        path = np.array([_transom_point(y, z) for y in np.linspace(half, -half, 15)])
        made.append(m.sweep(path, m.rounded_rectangle(0.012, 0.018, 0.004)))
    return made


def _crown() -> list[m.Mesh]:
    """The arched top of the stern with its border."""
    half = float(HULL.breadth(np.array(0.0), 0.1))
    y = np.linspace(half, -half, 31)
    x = np.full(31, _transom_point(0.0, 0.1)[0] - 0.004)
    arch = np.column_stack([x, y, 0.1 + 0.075 * np.sqrt(np.maximum(1.0 - (y / half) ** 2, 0.0))])
    field = patch(np.stack([np.column_stack([x, y, np.full(31, 0.09)]), arch]) + [0.004, 0.0, 0.0])
    back = patch(np.stack([np.column_stack([x, y, np.full(31, 0.09)]), arch]) + [0.012, 0.0, 0.0], flip=True)
    return [field, back, m.sweep(arch + [0.006, 0.0, 0.0], m.rounded_rectangle(0.022, 0.026, 0.006))]


def _gallery() -> list[m.Mesh]:
    """A balcony behind the cabin windows: floor and balustrade."""
    y = np.linspace(0.135, -0.135, 17)
    wall = np.array([_transom_point(each, -0.014) for each in y])
    edge = wall - np.column_stack([0.045 - 0.6 * y * y, np.zeros(17), np.zeros(17)])
    floor = np.stack([edge, wall + [0.01, 0.0, 0.0]])
    rim = patch(np.stack([edge - [0.0, 0.0, 0.01], edge]))
    turned, rail = j.balustrade(edge + [0.004, 0.0, 0.0], 0.04, 22, 0.012)
    return [patch(floor, flip=True), patch(floor - [0.0, 0.0, 0.01]), rim, turned, rail]


def _head() -> tuple[Part, ...]:
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
    return part("head_rails", m.join(wood), paint.wale()), part("figurehead", m.join(figure), paint.gilt())


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
    lids, holes, barrels = [], [], []
    for at in _port_frames():
        lids.append(j.window(at, 0.044, 0.042, (1, 1))[0])
        holes.append(box((0.034, 0.036, 0.006)).moved(at @ m.shift((0.0, 0.0, -0.001))))
        lift = m.shift((0.024, 0.0, 0.006))
        lift[:3, :3] = np.array([[0.35, 0, -0.94], [0, 1, 0], [0.94, 0, 0.35]])
        lid = box((0.038, 0.042, 0.006), tile=0.06)
        lids.append(lid.moved(at @ lift @ m.shift((0.02, 0.0, 0.0))))
        level = m.frame(at[:3, 3], at[:3, 2] * [1, 1, 0.0])
        barrels.append(j.cannon(level @ m.shift((0.0, 0.0, -0.05)), 0.095))
    return (
        part("ports", both(m.join(lids)), paint.port()),
        part("port_holes", both(m.join(holes)), paint.dark()),
        part("guns", both(m.join(barrels)), paint.iron()),
    )
