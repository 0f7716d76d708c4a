"""Deck fittings of the scene "ship", and her dimensions. Bow along +x, starboard at y < 0."""

from dataclasses import dataclass

import numpy as np

from .. import meshes as m
from ..scene import Part, part
from ..shapes import hull as lines
from ..shapes import vessel as j
from ..shapes.hull import Hull
from ..shapes.scatter import both, shifted, slab
from . import ship_surfaces as paint

HULL = Hull()
WATER = -0.37  # level of the sea
WATER_RADIUS = 1.2

# Decks: stations from aft to fore, height above the sheer.
LEVELS: dict[str, tuple[tuple[float, float], float]] = {
    "waist": ((0.36, 0.73), -0.05),
    "quarterdeck": ((0.14, 0.37), 0.025),
    "poop": ((0.0, 0.15), 0.095),
    "forecastle": ((0.72, 0.985), 0.03),
}
# Bulwarks: stations, foot and head above the sheer.
BULWARKS: dict[str, tuple[tuple[float, float], float, float]] = {
    "waist": ((0.3705, 0.7195), 0.0, 0.03),
    "quarterdeck": ((0.0, 0.37), 0.0, 0.08),
    "poop": ((0.0, 0.15), 0.08, 0.15),
    "forecastle": ((0.72, 0.985), 0.0, 0.08),
}
# How far the inside of each bulwark reaches below its foot: to its deck.
LINING = {"waist": 0.06, "quarterdeck": 0.0, "poop": 0.0, "forecastle": 0.0}
BOWSPRIT = (np.array([0.48, 0.0, -0.035]), np.array([1.10, 0.0, 0.225]))
_CAPSTAN = [
    (0.0, 0.0), (0.042, 0.0), (0.042, 0.008), (0.024, 0.016), (0.02, 0.04), (0.026, 0.055), (0.036, 0.058),
    (0.036, 0.074), (0.028, 0.08), (0.0, 0.082),
]  # fmt: skip

# Gratings: deck, x of the middle, length, width.
_GRATINGS = (
    ("waist", 0.10, 0.10, 0.11),
    ("waist", -0.15, 0.08, 0.1),
    ("quarterdeck", -0.37, 0.07, 0.08),
    ("forecastle", 0.47, 0.05, 0.07),
)
# Ladders, one on either side: lower deck and x, upper deck and x, distance from the middle, width.
_LADDERS = (
    ("waist", -0.175, "quarterdeck", -0.233, 0.11, 0.04),
    ("waist", 0.275, "forecastle", 0.318, 0.1, 0.04),
    ("quarterdeck", -0.56, "poop", -0.618, 0.1, 0.036),
)
_CASKS = ((0.02, 0.13), (0.055, 0.135), (0.04, -0.135), (-0.11, 0.13), (-0.19, -0.05), (-0.19, -0.015))


@dataclass(frozen=True)
class MastPlan:
    """One mast: heights of its pole from the deck up, and its yards as (height, half length, furled sail radius)."""

    name: str
    x: float
    foot: float
    top: float  # the platform
    crosstrees: float
    head: float
    rake: float  # x per unit of height, aft is negative
    radius: float
    yards: tuple[tuple[float, float, float], ...]
    brace: float  # degrees the yards are turned

    def at(self, z: float, forward: float = 0.0) -> np.ndarray:
        """The mast's axis at a height."""
        return np.array([self.x + self.rake * (z - self.foot) + forward, 0.0, z])


FORE = MastPlan(
    "fore", 0.40, -0.09, 0.30, 0.60, 0.84, 0.03, 0.019,
    ((0.215, 0.30, 0.031), (0.50, 0.22, 0.026), (0.73, 0.14, 0.018)), 9.0,
)  # fmt: skip
MAIN = MastPlan(
    "main", -0.04, -0.24, 0.38, 0.74, 1.02, -0.02, 0.022,
    ((0.275, 0.35, 0.035), (0.62, 0.25, 0.029), (0.89, 0.16, 0.02)), 9.0,
)  # fmt: skip
MIZZEN = MastPlan(
    "mizzen", -0.47, -0.06, 0.30, 0.52, 0.68, -0.05, 0.016,
    ((0.225, 0.2, 0.0), (0.445, 0.16, 0.019)), 9.0,
)  # fmt: skip
MASTS = (FORE, MAIN, MIZZEN)


def deck_z(name: str, u: float) -> float:
    """Height of a deck's edge at a station."""
    return float(HULL.sheer(np.array(u))) + LEVELS[name][1]


def deck_at(name: str, x: float, y: float = 0.0) -> np.ndarray:
    """A point on a deck's planks, camber included."""
    u = HULL.station(x, deck_z(name, 0.5))
    z = deck_z(name, u)
    half = max(float(HULL.breadth(np.array(u), z)) - 0.008, 1e-3)
    return np.array([x, y, z + 0.01 * (1.0 - min(abs(y) / half, 1.0) ** 2) * min(half / 0.1, 1.0)])


def parts() -> tuple[Part, ...]:
    return (*_deck_work(), *_boat(), *_anchors())


def _deck_work() -> tuple[Part, ...]:
    work = []
    for deck, x, length, width in _GRATINGS:
        low = deck_at(deck, x) + [-length / 2, -width / 2, -0.012]
        work.append(j.grating(low, low + [length, width, 0.03], 0.012))
    for low_deck, x0, high_deck, x1, y, width in _LADDERS:
        rise = deck_at(low_deck, x0, -y), deck_at(high_deck, x1, -y) + [0.0, 0.0, 0.012]
        work.append(both(j.ladder(*rise, width, 6)))
    helm = deck_at("quarterdeck", -0.53)
    work.append(slab(helm + [-0.03, -0.016, -0.006], helm + [-0.006, 0.016, 0.06], 0.2))
    binnacle = deck_at("quarterdeck", -0.43)
    work.append(slab(binnacle + [-0.012, -0.02, -0.006], binnacle + [0.012, 0.02, 0.04], 0.2))
    steering = j.wheel(m.frame(helm + [0.0, 0.0, 0.045], (1.0, 0.0, 0.0)), 0.038)
    casks = [j.barrel(m.shift(deck_at("waist", x, y) - [0.0, 0.0, 0.003]), 0.042) for x, y in _CASKS]
    return (
        part("hatches", m.join(work), paint.joinery()),
        part("capstan", m.join([*_capstan(deck_at("waist", 0.2)), steering]), paint.turned()),
        part("casks", m.join(casks), paint.cask()),
    )


def _capstan(spot: np.ndarray) -> list[m.Mesh]:
    made = [shifted(m.revolve(_CAPSTAN, 16), spot)]
    for a in np.linspace(0.0, 2.0 * np.pi, 6, endpoint=False):
        out = np.array([np.cos(a), np.sin(a), 0.0])
        bar = np.linspace(0.03 * out, 0.075 * out, 3) + spot + [0.0, 0.0, 0.066]
        made.append(m.sweep(bar, m.circle(0.0035, 6)))
    return made


def _boat() -> tuple[Part, ...]:
    small = lines.Hull(
        keel_z=0.0, half_beam=0.042, keel_ends=(-0.09, 0.075), sheer_ends=(-0.105, 0.115),
        sheer_z=(0.052, 0.042, 0.055), tumblehome=0.02,
    )  # fmt: skip
    skin = m.join([lines.planking(small, 30, 10), lines.transom(small, 1.0, 8, 8)])
    rail = lines.strip(small, (0.0, 0.99), 0.0, m.rounded_rectangle(0.006, 0.006, 0.002), stations=30)
    benches = [slab((x, -0.036, 0.028), (x + 0.016, 0.036, 0.032), 0.1) for x in (-0.06, -0.01, 0.04)]
    oars = [
        m.sweep(np.linspace([-0.09, y, 0.038], [0.07, 0.6 * y, 0.042], 4), m.circle(0.0028, 6))
        for y in (-0.02, -0.01, 0.012)
    ]
    chocks = [slab((x, -0.03, -0.012), (x + 0.012, 0.03, 0.012), 0.1) for x in (-0.05, 0.04)]
    spot = deck_at("waist", 0.10) + [0.0, 0.0, 0.028]
    wood = m.join([rail, *benches, *oars, *chocks])
    return part("boat", shifted(skin, spot), paint.boat()), part(
        "boat_wood", shifted(wood, spot), paint.joinery()
    )


def _anchor() -> tuple[m.Mesh, m.Mesh]:
    """An anchor that stands on its crown, arms along x: (iron, wooden stock)."""
    shank = m.sweep(
        np.linspace([0, 0, 0.0], [0, 0, 0.13], 6),
        m.circle(1.0, 8),
        np.linspace(0.0075, 0.005, 6),
        up=(1, 0, 0),
    )
    angle = np.linspace(-1.0, 1.0, 17)
    arms = np.column_stack([0.06 * np.sin(angle), np.zeros(17), 0.06 - 0.06 * np.cos(angle)])
    iron = [shank, m.sweep(arms, m.circle(0.0068, 8), 1.0 - 0.45 * np.abs(angle), up=(0, 1, 0))]
    for side in (-1.0, 1.0):
        palm = slab((-0.012, -0.013, -0.003), (0.012, 0.013, 0.003))
        iron.append(
            palm.moved(m.frame((0.047 * side, 0.0, 0.031), (-0.5 * side, 0.0, 0.85), (0.0, 1.0, 0.0)))
        )
    ring = 0.011 * np.column_stack([np.cos(angle * np.pi), np.zeros(17), np.sin(angle * np.pi)])[:-1]
    iron.append(shifted(m.sweep(ring, m.circle(0.0022, 6), up=(0, 1, 0), closed=True), (0, 0, 0.139)))
    stock = m.sweep(
        np.linspace([0, -0.055, 0.118], [0, 0.055, 0.118], 5), m.rounded_rectangle(0.013, 0.013, 0.003),
        np.array([0.7, 0.9, 1.1, 0.9, 0.7]),
    )  # fmt: skip
    return m.join(iron), stock


def _anchors() -> tuple[Part, ...]:
    foot, head = HULL.at(0.53, -0.275, 0.012), HULL.at(0.545, -0.14, 0.03)
    at = m.frame(foot, head - foot, (1.0, 0.25, 0.0))
    iron, stock = (piece.moved(at) for piece in _anchor())
    outboard = HULL.at(0.53, deck_z("forecastle", HULL.station(0.53, -0.1))) + [0.0, 0.0, 0.012]
    cathead = shifted(slab((-0.011, -0.075, -0.011), (0.011, 0.05, 0.011), 0.15), outboard)
    ring = at[:3, 3] + 0.149 * at[:3, 2]
    tie = j.rope(ring, outboard + [0.0, -0.07, 0.0], 0.0035)
    cable = j.line(m.spline([ring, HULL.at(0.58, -0.17, 0.03), HULL.at(0.60, -0.15, 0.004)], 6), 0.005, 6)
    return (
        part("anchors", both(iron), paint.iron()),
        part("catheads", both(m.join([cathead, stock])), paint.oak()),
        part("anchor_cables", both(m.join([tie, cable])), paint.rope("cable", (0.62, 0.5, 0.33), 29)),
    )
