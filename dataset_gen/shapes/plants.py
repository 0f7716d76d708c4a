"""Small trees: how stems, limbs and twigs branch, places for leaves, and the leaves."""

from dataclasses import dataclass

import numpy as np

from ..meshes import Mesh, spline

_GOLDEN = np.pi * (3.0 - np.sqrt(5.0))
_THICK = 0.0011  # half the thickness at the midrib, scene units
_ALONG, _ACROSS = 10, 5  # points of a blade; odd across: the midrib has its own row


@dataclass(frozen=True)
class Axis:
    """A woody axis: its middle line and its radius along it."""

    path: np.ndarray  # [P, 3]
    radius: np.ndarray  # [P]

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray, float]:
        """Point, direction and radius at a share t of the way."""
        place = t * (len(self.path) - 1)
        i = min(int(place), len(self.path) - 2)
        step = self.path[i + 1] - self.path[i]
        radius = float(np.interp(place, np.arange(len(self.radius)), self.radius))
        return self.path[i] + (place - i) * step, step / np.linalg.norm(step), radius


def drooping(
    start: np.ndarray,
    heading: np.ndarray,
    length: float,
    droop: float,
    radii: tuple[float, float],
    rng: np.random.Generator,
    wander: float = 0.12,
    points: int = 14,
) -> Axis:
    """An axis that leaves along `heading` and sinks under its weight, by `droop` × length at its end."""
    t = np.linspace(0.0, 1.0, points)[:, None]
    across = rng.normal(size=(2, 3)) * wander * length
    path = start + length * t * heading + across[0] * t**2 * (1.0 - t) * 2.0 + across[1] * t**2 * 0.5
    path[:, 2] -= droop * length * t[:, 0] ** 2
    return Axis(path, radii[0] + (radii[1] - radii[0]) * t[:, 0] ** 0.8)


def stem(points: np.ndarray, radii: tuple[float, float], flare: float, rng: np.random.Generator) -> Axis:
    """A trunk through points, with knots and swellings, flared by `flare` at its foot."""
    path = spline(list(points), 10)
    t = np.linspace(0.0, 1.0, len(path))
    radius = radii[0] + (radii[1] - radii[0]) * t
    knots = 1.0 + 0.1 * np.sin(2.0 * np.pi * (6.5 * t + rng.uniform())) * np.sin(
        2.0 * np.pi * (2.3 * t + rng.uniform())
    )
    return Axis(path, radius * knots * (1.0 + flare * np.exp(-t / 0.06)))


def limbs(
    trunk: Axis,
    count: int,
    first: float,
    length: tuple[float, float],
    rng: np.random.Generator,
    turn: float = 0.0,
) -> list[Axis]:
    """Limbs around a trunk from a share `first` of its height to its top; they start inside the wood."""
    made = []
    for k, t in enumerate(np.linspace(first, 0.99, count)):
        point, _, radius = trunk.at(float(t))
        azimuth = turn + k * _GOLDEN + rng.uniform(-0.3, 0.3)
        rise = np.radians(28.0 + 42.0 * (t - first) / (1.0 - first) + rng.uniform(-8.0, 8.0))
        heading = np.array([np.cos(rise) * np.cos(azimuth), np.cos(rise) * np.sin(azimuth), np.sin(rise)])
        reach = length[0] + (length[1] - length[0]) * t + rng.uniform(-0.05, 0.05)
        thick = 0.62 * radius
        made.append(drooping(point, heading, reach, 0.32, (thick, 0.3 * thick), rng))
    return made


def twigs(limb: Axis, count: int, length: tuple[float, float], rng: np.random.Generator) -> list[Axis]:
    """Twigs on alternate sides of a limb; the last one goes on from its end."""
    made = []
    for k, t in enumerate(np.linspace(0.3, 1.0, count)):
        point, along, radius = limb.at(float(t))
        side = np.cross(along, [0.0, 0.0, 1.0])
        side = side / np.linalg.norm(side) * (1.0 if k % 2 else -1.0) * (0.25 if t == 1.0 else 1.0)
        heading = along * 0.8 + side * rng.uniform(0.5, 1.0) + np.array([0.0, 0.0, rng.uniform(-0.1, 0.35)])
        heading /= np.linalg.norm(heading)
        reach = rng.uniform(*length)
        thick = 0.8 * min(radius, 0.0045)
        made.append(drooping(point, heading, reach, 0.38, (thick, 0.4 * thick), rng, points=9))
    return made


def leaf_places(twig: Axis, spacing: float, rng: np.random.Generator, first: float = 0.12) -> np.ndarray:
    """Frames [N, 4, 4] of leaf stalks on alternate sides of a twig: x outwards from the wood, z roughly up."""
    length = float(np.linalg.norm(np.diff(twig.path, axis=0), axis=1).sum())
    count = max(3, round(length * (1.0 - first) / spacing))
    frames = np.tile(np.eye(4), (count, 1, 1))
    for k, t in enumerate(np.linspace(first, 1.0, count)):
        point, along, _ = twig.at(float(t))
        side = np.cross(along, [0.0, 0.0, 1.0])
        side = side / np.linalg.norm(side) * (1.0 if k % 2 else -1.0)
        out = (
            0.75 * along
            + side * rng.uniform(0.5, 1.2) * (0.2 if k == count - 1 else 1.0)
            + rng.normal(size=3) * 0.2
        )
        out[2] -= rng.uniform(0.0, 0.5)
        out /= np.linalg.norm(out)
        up = np.array([0.0, 0.0, 1.0]) + rng.normal(size=3) * 0.38
        up -= out * (up @ out)
        up /= np.linalg.norm(up)
        frames[k, :3, :3] = np.column_stack([out, np.cross(up, out), up])
        frames[k, :3, 3] = point
    return frames


@dataclass(frozen=True)
class Leaves:
    """Shapes of N leaves; each array [N]."""

    length: np.ndarray  # scene units
    width: np.ndarray  # of the widest place, scene units
    droop: np.ndarray  # radians the blade turns down from its base to its tip
    fold: np.ndarray  # rise of the halves beside the midrib, per unit of width
    ripple: np.ndarray  # height of the margin's waves, per unit of width
    phase: np.ndarray  # of those waves, radians
    band: (
        np.ndarray
    )  # whole number: which band of the picture its upper face takes; the next is the lower face's

    def __len__(self) -> int:
        return len(self.length)


def outline(t: np.ndarray) -> np.ndarray:
    """Half-width of an ovate blade with a drawn-out tip, 0..1, from base (t = 0) to tip (t = 1)."""
    shape = t**0.62 * (1.0 - t) ** 1.12
    return np.asarray(shape / 0.5026)  # its maximum, at t = 0.62 / 1.74


def blades(frames: np.ndarray, leaves: Leaves, bands: int) -> Mesh:
    """Blades at frames [N, 4, 4]: x runs from base to tip, z is the upper side.

    Texture: u from base to tip; v within one of `bands` equal strips of the picture, upper and lower face in two.
    """
    t, c = np.linspace(0.0, 1.0, _ALONG), np.linspace(-1.0, 1.0, _ACROSS)
    local = _middle(leaves, t, c)
    body = _THICK * (1.0 - c**2)[None, None] * np.sqrt(outline(t))[None, :, None]
    turn = -leaves.droop[:, None] * t
    normal = np.stack([-np.sin(turn), np.zeros_like(turn), np.cos(turn)], -1)[:, :, None]
    faces, uv = [], []
    quads = _triangles()
    for side, triangles in ((1.0, quads[:, ::-1]), (-1.0, quads)):
        points = local + side * body[..., None] * normal
        world = np.einsum("nij,nrsj->nrsi", frames[:, :3, :3], points) + frames[:, None, None, :3, 3]
        faces.append(world.reshape(len(leaves), -1, 3))
        strip = (leaves.band + (side < 0))[:, None, None] + 0.5 + 0.46 * c[None, None]
        v = np.broadcast_to(strip / bands, (len(leaves), _ALONG, _ACROSS))
        u = np.broadcast_to(t[None, :, None], v.shape)
        uv.append(np.stack([u, v], -1).reshape(len(leaves), -1, 2)[:, triangles])
    each = _ALONG * _ACROSS
    starts = 2 * each * np.arange(len(leaves))[:, None, None]
    both = np.concatenate([quads[:, ::-1] + starts, quads + each + starts], axis=1)
    vertices = np.concatenate(faces, axis=1).reshape(-1, 3)
    return Mesh(vertices, both.reshape(-1, 3).astype(np.int32), np.concatenate(uv, axis=1).reshape(-1, 3, 2))


def _middle(leaves: Leaves, t: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Middle surface [N, R, S, 3] of the blades in their own frames."""
    turn = -leaves.droop[:, None] * t
    step = leaves.length[:, None] / (_ALONG - 1)
    x, z = (np.cumsum(step * f(turn), axis=1) - step * f(turn[:, :1]) for f in (np.cos, np.sin))
    half = 0.5 * leaves.width[:, None] * outline(t)
    rise = leaves.fold[:, None, None] * np.abs(c) + (
        leaves.ripple[:, None] * np.sin(11.0 * t + leaves.phase[:, None])
    )[..., None] * c**2 * np.sign(c + 1e-9)
    rise = rise * half[..., None]
    return np.stack(
        [
            x[..., None] - rise * np.sin(turn)[..., None],
            half[..., None] * c,
            z[..., None] + rise * np.cos(turn)[..., None],
        ],
        -1,
    )


def _triangles() -> np.ndarray:
    """Return [F, 3] of one sheet, without those that vanish at base and tip; normals along −z."""
    r, s = (k.ravel() for k in np.meshgrid(np.arange(_ALONG - 1), np.arange(_ACROSS - 1), indexing="ij"))
    a, b = r * _ACROSS + s, r * _ACROSS + s + 1
    first, second = np.column_stack([a, b, b + _ACROSS]), np.column_stack([a, b + _ACROSS, a + _ACROSS])
    return np.concatenate([first[r > 0], second[r < _ALONG - 2]])


def stalks(paths: np.ndarray, radius: np.ndarray, sides: int = 4) -> Mesh:
    """Thin tubes along N paths [N, P, 3] of radii [N, P]; u along, v around; ends are open."""
    count, points = paths.shape[:2]
    direction = paths[:, -1] - paths[:, 0]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    helper = np.where(np.abs(direction[:, 2:]) > 0.9, [[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]])
    first = np.cross(helper, direction)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(direction, first)
    angle = 2.0 * np.pi * np.arange(sides) / sides
    ring = np.cos(angle)[:, None] * first[:, None] + np.sin(angle)[:, None] * second[:, None]
    vertices = paths[:, :, None] + radius[:, :, None, None] * ring[:, None]
    r, s = (k.ravel() for k in np.meshgrid(np.arange(points - 1), np.arange(sides), indexing="ij"))
    right = (s + 1) % sides
    a, b, c, d = r * sides + s, r * sides + right, (r + 1) * sides + right, (r + 1) * sides + s
    quads = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    u, v = np.stack([r, r, r + 1, r + 1]) / (points - 1), np.stack([s, s + 1, s + 1, s]) / sides
    corner = np.stack([u, v], -1)
    uv = np.concatenate([corner[[0, 1, 2]], corner[[0, 2, 3]]], axis=1).transpose(1, 0, 2)
    starts = points * sides * np.arange(count)[:, None, None]
    triangles = (quads[None] + starts).reshape(-1, 3).astype(np.int32)
    return Mesh(vertices.reshape(-1, 3), triangles, np.tile(uv, (count, 1, 1)))
