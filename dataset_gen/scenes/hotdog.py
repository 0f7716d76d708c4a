"""The scene "hotdog": two hot dogs on a decorated plate, one with mustard, one with ketchup; the plate stands still."""

from dataclasses import dataclass

import numpy as np

from .. import meshes as m
from ..patterns.solid import fractal, noise, of_grid
from ..scene import AreaLight, Gradient, Part, Scene, part
from ..shapes.scatter import copies, on_surface
from ..shapes.sheet import edged, puff, puff_points, rounded
from . import hotdog_surfaces as paint

FLOOR = -0.205  # the plate's upper face, where the buns lie
RADIUS = 0.135  # of a sausage
HALF_BUN, HALF_SAUSAGE = 0.83, 0.95  # half lengths
AXIS_HEIGHT = FLOOR + 0.283  # of the sausage's middle
_INSIDE, _GAP = 0.05, 0.004  # thickness of the bun towards the sausage, and the air between
_OPENING = np.radians(119.0)  # the bun reaches round the sausage to this angle from straight below
_BOW = 0.05  # a sausage's ends lie this much higher

# The plate, (radius, height): underside from the middle out, foot, lip, then the upper face back to the middle.
PLATE = [
    (0.0, -0.275), (0.56, -0.275), (0.58, -0.30), (0.62, -0.30), (0.64, -0.275), (0.9, -0.258), (1.0, -0.23),
    (1.12, -0.185), (1.215, -0.148), (1.236, -0.136), (1.24, -0.124), (1.232, -0.115), (1.215, -0.114),
    (1.12, -0.143), (1.05, -0.163), (1.0, -0.178), (0.965, -0.192), (0.94, -0.2), (0.9, -0.2045), (0.86, FLOOR),
    (0.7, FLOOR), (0.5, FLOOR), (0.3, FLOOR), (0.0, FLOOR),
]  # fmt: skip


@dataclass(frozen=True)
class _Dog:
    name: str
    y: float
    heading: float  # radians, turned on the plate
    seed: int

    @property
    def placed(self) -> np.ndarray:
        """Return [4, 4]: from its own frame, with the sausage along x, to the plate."""
        c, s = np.cos(self.heading), np.sin(self.heading)
        out = np.eye(4)
        out[:2, :2] = [[c, -s], [s, c]]
        out[1, 3] = self.y
        return out


_DOGS = (_Dog("left", 0.37, np.radians(3.5), 1), _Dog("right", -0.37, np.radians(-2.5), 2))


def build() -> Scene:
    parts = [part("plate", m.revolve(PLATE, 144), paint.plate(PLATE))]
    for dog in _DOGS:
        parts += _hot_dog(dog)
    return Scene(
        name="hotdog",
        parts=(*parts, *_on_the_plate()),
        lights=(AreaLight((2.6, -2.4, 3.8), 2.6, 150.0, (1.0, 0.95, 0.86)),),
        sky=Gradient(((0.3, 0.26, 0.22), (0.5, 0.49, 0.48), (0.85, 0.92, 1.05))),
    )


def _spine(x: np.ndarray) -> np.ndarray:
    """The sausage's middle line [..., 3] over x."""
    return np.stack([x, 0.0 * x, AXIS_HEIGHT + _BOW * (x / HALF_SAUSAGE) ** 2], -1)


def _around(x: np.ndarray, angle: np.ndarray, radius: np.ndarray | float) -> np.ndarray:
    """Points [..., 3] at an angle from straight above about the spine; positive towards +y."""
    off = np.stack([0.0 * angle, np.sin(angle), np.cos(angle)], -1)
    return _spine(x) + np.asarray(radius)[..., None] * off


def _hot_dog(dog: _Dog) -> list[Part]:
    rng = np.random.default_rng([31, dog.seed])
    bun, texels = _bun(dog)
    sausage = m.sweep(*_sausage(), up=(0.0, 0.0, 1.0))
    sauce = _mustard() if dog.name == "left" else _ketchup()
    made = [
        (f"bun_{dog.name}", bun, paint.bun(texels, AXIS_HEIGHT, dog.seed)),
        (f"sausage_{dog.name}", sausage, paint.sausage(RADIUS, 2.0 * HALF_SAUSAGE, dog.seed)),
        (f"seeds_{dog.name}", _seeds(bun, rng), paint.sesame()),
    ]
    sauces = (f"mustard_{dog.name}", sauce, paint.mustard()), (f"ketchup_{dog.name}", sauce, paint.ketchup())
    made.append(sauces[0] if dog.name == "left" else sauces[1])
    return [part(name, mesh.moved(dog.placed), surface) for name, mesh, surface in made]


def _flattened(points: np.ndarray) -> np.ndarray:
    """Pressed onto the plate: nothing reaches below it, and what would lies flat."""
    out = points.copy()
    depth = out[..., 2] - FLOOR
    out[..., 2] = FLOOR + 0.5 * (depth + np.sqrt(depth**2 + 0.014**2))
    return out


def _bun(dog: _Dog) -> tuple[m.Mesh, np.ndarray]:
    """A thick slab of dough bent round the sausage; and where its texture's texels lie, [H, W, 3]."""
    along, across = edged(150, 0.75), edged(96, 0.75)
    x = np.broadcast_to(HALF_BUN * along[:, None], (150, 96))
    angle = np.pi - _OPENING * across[None] * (1.0 - 0.2 * np.abs(along[:, None]) ** 7)  # round corners
    lean = 0.02 * np.sin(2.3 * x + dog.seed)
    middle = _around(x, angle + lean, RADIUS + _GAP + _INSIDE + 0.0 * x)
    # The ends of the slab are not cut straight: they swing out in the middle of the bun's height.
    middle[..., 0] *= 1.0 - 0.06 * np.abs(across[None]) ** 3
    edge = rounded(along, 2.2)[:, None] * rounded(across, 2.3)[None]
    belly = 0.12 + 0.075 * np.sin(np.pi * np.abs(across)) ** 2  # fat cheeks, thinner bottom and lips
    bulge = 1.0 + 0.07 * noise(middle, 2.2, dog.seed) + 0.025 * noise(middle, 6.0, dog.seed)
    taper = 0.5 + 0.5 * rounded(along, 2.1)[:, None]
    outside, inside = (
        edge * belly[None] * bulge * taper,
        _INSIDE * rounded(along, 6.0)[:, None] * rounded(across, 5.0),
    )
    mesh = puff(middle, outside, inside)
    texels = of_grid(puff_points(middle, outside, inside), 480, 768)
    return m.Mesh(_flattened(mesh.vertices), mesh.triangles, mesh.uv), _flattened(texels)


def _sausage() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Path, section and scale of a sausage: plump, a little uneven, a twisted nub of casing at both ends."""
    along = edged(150, 0.93)
    path = _spine(along * HALF_SAUSAGE)
    size = RADIUS * rounded(along, 7.0) ** 0.9 * (1.0 - 0.02 * (1.0 - np.cos(9.0 * along)))
    nub = 0.022 * (1.0 + 0.3 * np.sin(400.0 * (1.0 - np.abs(along))))
    tip = np.linspace(1.0, 1.03, 8)[1:]
    tips = _spine(tip * HALF_SAUSAGE)
    path = np.vstack([tips[::-1] * [-1, 1, 1], path, tips])
    ends = 0.022 * np.array([1.0, 0.9, 1.1, 1.25, 1.2, 0.9, 0.25])
    size = np.concatenate([ends[::-1], np.maximum(size, nub), ends])
    return path, m.circle(1.0, 56), size


def _squeezed(x: np.ndarray, angle: np.ndarray, radius: np.ndarray) -> m.Mesh:
    """A bead of sauce along (x, angle) on the sausage, flattened where it lies on it."""
    section = m.circle(1.0, 14) * [0.86, 1.08]
    path = _around(x, angle, RADIUS + 0.62 * radius)
    first = path[0] - _spine(x[:1])[0]
    return m.sweep(path, section, radius, up=first)


def _bead(count: int, radius: float, seed: int) -> np.ndarray:
    """Radius [count] of a bead that is squeezed unevenly, thick at its start, thin at its end."""
    t = np.linspace(0.0, 1.0, count)
    line = np.stack([60.0 * t, 0.0 * t, 0.0 * t], -1)
    size = radius * (1.0 + 0.13 * noise(line, 0.35, seed) + 0.05 * noise(line, 1.4, seed))
    size *= 1.0 + 0.35 * np.exp(-(((t - 0.012) / 0.012) ** 2))
    return (
        size
        * np.minimum(
            rounded(np.minimum(t / 0.01, 1.0) - 1.0, 2.0), rounded(np.maximum((t - 0.985) / 0.015, 0.0), 2.0)
        )
        + 1e-4
    )


def _mustard() -> m.Mesh:
    t = np.linspace(0.0, 1.0, 900)
    wave = np.arcsin(0.965 * np.sin(2.0 * np.pi * 9.5 * t)) / np.arcsin(0.965)
    wobble = np.stack([8.0 * t, 0.0 * t, 0.0 * t], -1)
    x = -0.80 + 1.6 * t + 0.012 * noise(wobble, 1.0, 5)
    return _squeezed(x, wave * (0.66 + 0.08 * noise(wobble, 0.8, 6)), _bead(900, 0.0265, 7))


def _ketchup() -> m.Mesh:
    t = np.linspace(0.0, 1.0, 900)
    turn = 2.0 * np.pi * 7.5 * t
    wobble = np.stack([8.0 * t, 0.0 * t, 0.0 * t], -1)
    x = 0.79 - 1.58 * t + 0.055 * np.sin(2.0 * turn)
    return _squeezed(x, 0.6 * np.sin(turn) + 0.06 * noise(wobble, 0.8, 9), _bead(900, 0.029, 8))


def _seeds(bun: m.Mesh, rng: np.random.Generator) -> m.Mesh:
    """Sesame on the crust: drops that lie flat on the upper half of the outside."""
    outside = bun.uv[:, :, 1].max(1) < 0.47
    centres = bun.vertices[bun.triangles].mean(1)
    high = np.clip((centres[:, 2] - FLOOR - 0.16) / 0.2, 0.0, 1.0)
    points, up = on_surface(bun, 210, rng, 0.033, outside * high * (0.4 + rng.random(len(high))))
    drop = [
        (0.0, -0.5), (0.2, -0.47), (0.36, -0.35), (0.43, -0.15), (0.4, 0.08), (0.27, 0.33), (0.12, 0.48),
        (0.0, 0.5),
    ]  # fmt: skip
    seed = m.revolve(drop, 10, 180.0)
    lying = m.Mesh(
        seed.vertices[:, [2, 0, 1]] * [0.044, 0.027, 0.017] + [0.0, 0.0, 0.004], seed.triangles, seed.uv
    )
    return copies(lying, points, up, rng, (0.85, 1.15))


def _on_the_plate() -> tuple[Part, ...]:
    rng = np.random.default_rng([31, 9])
    angle, radius = rng.uniform(0.0, 2.0 * np.pi, 900), 0.99 * np.sqrt(rng.uniform(0.02, 0.98, 900))
    spots = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    clear = np.min([np.abs(spots[:, 1] - d.y) for d in _DOGS], 0) > 0.29
    clear |= np.abs(spots[:, 0]) > 0.86
    spots = spots[clear]
    level = np.interp(
        np.linalg.norm(spots, axis=1), [p[0] for p in PLATE[:12:-1]], [p[1] for p in PLATE[:12:-1]]
    )
    points = np.column_stack([spots, level])
    up = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
    crumbs = copies(_crumb(), points[:110], up[:110], rng, (0.25, 1.0))
    drops = copies(
        m.revolve([(0.0, -0.004), (1.0, -0.003), (1.04, 0.1), (0.9, 0.33), (0.5, 0.48), (0.0, 0.52)], 28, 180.0),
        points[110:122], up[:12], rng, (0.018, 0.042),
    )  # fmt: skip
    return (part("crumbs", crumbs, paint.crumb()), part("drops", drops, paint.ketchup()))


def _crumb() -> m.Mesh:
    arc = [(np.sin(a), -np.cos(a)) for a in np.linspace(0.0, np.pi, 9)]
    ball = m.revolve(arc, 14)
    swell = 0.02 * (1.0 + 0.28 * fractal(ball.vertices, 0.9, 3, 4))
    points = ball.vertices * swell[:, None] * [1.0, 1.0, 0.75]
    return m.Mesh(points - [0.0, 0.0, points[:, 2].min() + 0.002], ball.triangles, ball.uv)
