"""The lines of a wooden ship: a hull from keel to sheer, upper works above it, decks, wales."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..meshes import Mesh, join, sweep
from .scatter import patch
from .solids import mirrored

Height = float | Callable[[np.ndarray], np.ndarray]  # above the sheer, constant or by station u


def _smooth(x: np.ndarray) -> np.ndarray:
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


@dataclass(frozen=True)
class Hull:
    """Bow along +x, up +z. Stations u run from 0 (stern) to 1 (stem), heights s from 0 (keel) to 1 (sheer).

    Above the sheer s goes on beyond 1, so that upper works continue the side's slope.
    """

    keel_z: float = -0.52
    half_beam: float = 0.21
    keel_ends: tuple[float, float] = (-0.70, 0.44)  # x of sternpost and stem at the keel
    sheer_ends: tuple[float, float] = (-0.80, 0.68)  # x of transom and stem at the sheer
    sheer_z: tuple[float, float, float] = (-0.05, -0.19, -0.10)  # at the stern, lowest, at the stem
    transom: float = 0.70  # its width at the sheer, of the beam
    tumblehome: float = 0.16  # how much the side leans in above the wale, of the half beam

    def sheer(self, u: np.ndarray) -> np.ndarray:
        """Height of the sheer line at the stations."""
        stern, low, stem = self.sheer_z
        aft, fore = np.clip(1.0 - u / 0.5, 0.0, 1.0), np.clip((u - 0.5) / 0.5, 0.0, 1.0)
        return np.asarray(low + (stern - low) * aft**2 + (stem - low) * fore**2)

    def level(self, u: np.ndarray, z: np.ndarray | float) -> np.ndarray:
        """s of a height z at the stations."""
        return np.asarray((z - self.keel_z) / (self.sheer(u) - self.keel_z))

    def side(self, u: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Points [..., 3] of the starboard skin (y ≤ 0) at stations u and heights s, which broadcast."""
        u, s = np.broadcast_arrays(np.asarray(u, float), np.asarray(s, float))
        low = np.clip(s, 0.0, 1.0)
        aft = self.keel_ends[0] + (self.sheer_ends[0] - self.keel_ends[0]) * s
        fore = self.keel_ends[1] + (self.sheer_ends[1] - self.keel_ends[1]) * (low**0.55 + 0.25 * (s - low))
        z = self.keel_z + (self.sheer(u) - self.keel_z) * s
        y = -self.half_beam * self._plan(u, low) * self._section(u, s)
        return np.stack([aft + u * (fore - aft), y, z], -1)

    def _plan(self, u: np.ndarray, low: np.ndarray) -> np.ndarray:
        """Width of the waterlines along the ship: bluff bow, narrow run aft that opens into the transom."""
        bow = np.clip((u - 0.58) / 0.42, 0.0, 1.0)
        full = np.power(np.clip(1.0 - bow ** (1.7 + 1.1 * low), 0.0, 1.0), 0.9 - 0.25 * low)
        stern = self.transom * _smooth((low - 0.1) / 0.75)
        return np.asarray(full * (stern + (1.0 - stern) * _smooth(u / 0.5)))

    def _section(self, u: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Half-width of a frame over its height: round bilge amidships, sharper towards the ends."""
        widest = 0.62
        roundness = 1.45 + 1.1 * np.sin(np.pi * np.clip(u, 0.0, 1.0)) ** 2
        below = np.clip(s / widest, 0.0, 1.0)
        bilge = np.power(1.0 - np.power(1.0 - below, roundness), 1.0 / roundness)
        above = np.clip((s - widest) / (1.0 - widest), 0.0, 2.2)
        return np.asarray(bilge * (1.0 - self.tumblehome * above**1.3))

    def breadth(self, u: np.ndarray, z: np.ndarray | float) -> np.ndarray:
        """Half-breadth at stations u and height z."""
        return np.asarray(-self.side(u, self.level(u, z))[..., 1])

    def station(self, x: float, z: float) -> float:
        """u where the side passes through x at height z."""
        u = np.linspace(0.0, 1.0, 2001)
        return float(np.interp(x, self.side(u, self.level(u, z))[:, 0], u))

    def at(self, x: float, z: float, out: float = 0.0) -> np.ndarray:
        """A point on (or `out` beside) the starboard side at x and height z."""
        u = np.array([self.station(x, z)])
        return np.asarray(self.side(u, self.level(u, z))[0] + [0.0, -out, 0.0])


def planking(hull: Hull, stations: int = 120, strakes: int = 40) -> Mesh:
    """The skin from keel to sheer, both sides and the transom. u runs along the ship, v from keel to sheer."""
    u = 1.0 - (1.0 - np.linspace(0.0, 1.0, stations)) ** 1.4  # closer at the bluff bow
    s = np.linspace(0.0, 1.0, strakes)
    side = patch(hull.side(u[None], s[:, None]), np.stack(np.broadcast_arrays(u[None], s[:, None]), -1))
    return join([side, mirrored(side)])


def transom(hull: Hull, top: float, columns: int = 24, rows: int = 32) -> Mesh:
    """The flat stern from the keel to s = `top`, slightly bowed aft; u across, v upwards."""
    s = np.linspace(0.02, top, rows)
    edge = hull.side(np.zeros(rows), s)
    across = np.linspace(1.0, -1.0, columns)  # port to starboard: normals aft
    points = edge[:, None] * np.ones((1, columns, 1))
    points[..., 1] = edge[:, None, 1] * -across[None]
    points[..., 0] -= 0.1 * np.abs(edge[:, None, 1]) * (1.0 - across[None] ** 2)
    return patch(points)


def bulwark(
    hull: Hull,
    u_ends: tuple[float, float],
    low: Height,
    high: Height,
    thickness: float,
    lining: float = 0.0,
    stations: int = 60,
) -> Mesh:
    """A wall that continues both sides between two heights above the sheer: outside, top, inside, ends.

    The inside reaches `lining` further down than the outside, to the deck.
    """
    u = np.linspace(*u_ends, stations)
    z0, z1 = (hull.sheer(u) + (h(u) if callable(h) else h) for h in (low, high))
    rows = 6
    rise = np.linspace(0.0, 1.0, rows)[:, None]
    outer = hull.side(u[None], hull.level(u, z0 + (z1 - z0) * rise))
    inner = hull.side(u[None], hull.level(u, z0 - lining + (z1 - z0 + lining) * rise))
    inner[..., 1] = np.minimum(inner[..., 1] + thickness, -0.0005)
    v = np.broadcast_to(rise, (rows, stations))
    uv = np.stack([np.broadcast_to(u, v.shape), v], -1)
    rim = np.stack([outer[-1], inner[-1]])
    walls = [
        patch(outer, uv),
        patch(inner, uv, flip=True),
        patch(rim),
        patch(np.stack([outer[:, -1], inner[:, -1]], 1)),
        patch(np.stack([outer[:, 0], inner[:, 0]], 1), flip=True),
    ]
    wall = join(walls)
    return join([wall, mirrored(wall)])


def deck(
    hull: Hull,
    u_ends: tuple[float, float],
    height: Height,
    inset: float,
    stations: int = 48,
    camber: float = 0.01,
) -> Mesh:
    """A cambered deck between the bulwarks at a height above the sheer; u along the ship, v across."""
    u = np.linspace(*u_ends, stations)
    z = hull.sheer(u) + (height(u) if callable(height) else height)
    edge = hull.side(u, hull.level(u, z))
    across = np.linspace(-1.0, 1.0, 15)[:, None]
    half = np.maximum(-edge[:, 1] - inset, 0.0)
    x, y = np.broadcast_arrays(edge[:, 0], half * across)
    points = np.stack([x, y, z + camber * (1.0 - across**2) * np.minimum(half / 0.1, 1.0)], -1)
    uv = np.stack([x, y], -1)  # scene units: the planks keep their width
    return patch(points, uv)


def strip(
    hull: Hull,
    u_ends: tuple[float, float],
    height: Height,
    section: np.ndarray,
    out: float = 0.0,
    stations: int = 90,
) -> Mesh:
    """A wale, rail or moulding: a section swept along both sides at a height above the sheer.

    The section's x axis points up, so that its y axis points outboard.
    """
    u = np.linspace(*u_ends, stations)
    z = hull.sheer(u) + (height(u) if callable(height) else height)
    path = hull.side(u, hull.level(u, z)) + [0.0, -out, 0.0]
    made = sweep(path, section)
    return join([made, mirrored(made)])
