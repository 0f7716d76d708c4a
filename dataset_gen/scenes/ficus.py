"""The scene "ficus": a weeping fig with several stems and some thousand leaves in a glazed pot."""

import numpy as np

from .. import meshes as m
from ..scene import AreaLight, Gradient, Part, Scene, Surface, part
from ..shapes import plants
from ..shapes.scatter import pebbles
from . import ficus_surfaces as paint

FLOOR = -1.10
SOIL = -0.63  # height of the soil's rim
_MOUND = 0.03  # how much higher it is in the middle
_POT_RADIUS = 0.355  # outside, at the rim
_INNER = 0.318  # where the soil meets the wall

_POT = [
    (0.0, 0.028), (0.20, 0.028), (0.225, 0.024), (0.238, 0.03), (0.246, 0.045), (0.256, 0.08), (0.275, 0.16),
    (0.295, 0.25), (0.312, 0.33), (0.324, 0.395), (0.33, 0.43), (0.331, 0.447), (0.338, 0.452), (0.352, 0.455),
    (_POT_RADIUS, 0.463), (_POT_RADIUS + 0.002, 0.49), (_POT_RADIUS, 0.515), (0.348, 0.523), (0.335, 0.525),
    (0.325, 0.518), (0.321, 0.50), (_INNER, 0.46), (0.305, 0.40), (0.26, 0.38),
]  # fmt: skip
_SAUCER = [
    (0.0, 0.0), (0.26, 0.0), (0.285, 0.004), (0.30, 0.014), (0.322, 0.052), (0.328, 0.062), (0.324, 0.067),
    (0.314, 0.066), (0.306, 0.056), (0.286, 0.026), (0.27, 0.02), (0.0, 0.02),
]  # fmt: skip
# Stems: points from the foot to the top, radii there, number of limbs, share of the height of the first limb.
_STEMS = (
    (((0.03, 0.0, -0.66), (0.05, 0.03, -0.40), (-0.01, 0.055, -0.14), (-0.05, 0.01, 0.14), (0.0, -0.03, 0.44),
      (0.04, 0.0, 0.80)), (0.036, 0.012), 16, 0.50),
    (((-0.05, 0.04, -0.66), (-0.055, -0.005, -0.40), (0.0, -0.05, -0.15), (0.06, -0.02, 0.10), (0.16, 0.08, 0.34),
      (0.26, 0.16, 0.58)), (0.031, 0.011), 12, 0.52),
    (((-0.01, -0.06, -0.66), (0.02, -0.06, -0.42), (0.07, 0.0, -0.20), (0.03, 0.07, 0.05), (-0.10, 0.08, 0.26),
      (-0.27, 0.02, 0.50)), (0.028, 0.010), 11, 0.52),
)  # fmt: skip


def build() -> Scene:
    rng = np.random.default_rng([2032, 0])
    stems = [plants.stem(np.array(points), radii, 0.55, rng) for points, radii, _, _ in _STEMS]
    limbs = []
    for number, (stem, (_, _, count, first)) in enumerate(zip(stems, _STEMS, strict=True)):
        limbs += plants.limbs(stem, count, first, (0.78, 0.36), rng, turn=2.1 * number)
    surface = paint.foliage_strips()
    leaves = [part(f"leaves_{k:02d}", _cluster(limb, rng), surface) for k, limb in enumerate(limbs)]
    return Scene(
        name="ficus",
        parts=(*_pot(rng, surface), _trunk(stems), *leaves),
        lights=(AreaLight((2.8, -2.8, 3.8), 3.0, 235.0, (1.0, 0.95, 0.86)),),
        sky=Gradient(((0.32, 0.3, 0.26), (0.68, 0.68, 0.66), (0.98, 1.06, 1.18))),
    )


def _trunk(stems: list[plants.Axis]) -> Part:
    tubes = []
    for stem in stems:
        tube = m.sweep(stem.path, m.circle(1.0, 18), stem.radius, up=(1.0, 0.0, 0.0))
        tubes.append(tube)
    return part("trunk", m.join(tubes), paint.bark())


def _woody(axes: list[plants.Axis], sides: int) -> m.Mesh:
    """Limbs or twigs of equal numbers of points, painted with the bark strip of the foliage picture."""
    paths, radii = np.stack([a.path for a in axes]), np.stack([a.radius for a in axes])
    return _in_strip(plants.stalks(paths, radii, sides), paint.BARK, 2.0)


def _in_strip(mesh: m.Mesh, strip: int, repeats: float) -> m.Mesh:
    v = (strip + 0.04 + 0.92 * mesh.uv[..., 1]) / paint.STRIPS
    return m.Mesh(mesh.vertices, mesh.triangles, np.stack([repeats * mesh.uv[..., 0], v], -1))


def _cluster(limb: plants.Axis, rng: np.random.Generator) -> m.Mesh:
    twigs = plants.twigs(limb, 6, (0.16, 0.32), rng)
    places = np.concatenate([plants.leaf_places(twig, 0.039, rng) for twig in twigs])
    stalks, blades = _leaves(places, rng)
    return m.join([_woody([limb], 8), _woody(twigs, 6), stalks, blades])


def _leaves(places: np.ndarray, rng: np.random.Generator) -> tuple[m.Mesh, m.Mesh]:
    """Stalks that leave the wood at the places [N, 4, 4] and the blades at their ends."""
    n = len(places)
    size = rng.uniform(0.75, 1.15, n)
    reach = rng.uniform(0.018, 0.036, n)
    t = np.linspace(0.0, 1.0, 4)
    out, up, start = places[:, None, :3, 0], places[:, None, :3, 2], places[:, None, :3, 3]
    paths = (
        start + (reach[:, None] * t)[..., None] * out + (0.2 * reach[:, None] * t * (1.0 - t))[..., None] * up
    )
    stalks = plants.stalks(paths, np.full((n, 4), 0.0017) * np.linspace(1.15, 0.85, 4))
    kind = rng.choice(paint.KINDS, n, p=(0.42, 0.36, 0.17, 0.05))
    shapes = plants.Leaves(
        length=0.138 * size, width=0.066 * size * rng.uniform(0.85, 1.15, n), droop=rng.uniform(0.15, 1.25, n),
        fold=rng.uniform(0.05, 0.4, n), ripple=rng.uniform(0.05, 0.25, n), phase=rng.uniform(0.0, 6.3, n),
        band=2 * kind,
    )  # fmt: skip
    ends = places.copy()
    ends[:, :3, 3] = paths[:, -1] - 0.001 * out[:, 0]
    return _in_strip(stalks, 4, 0.3), plants.blades(ends, shapes, paint.STRIPS)


def ground(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of the soil."""
    r2 = (x**2 + y**2) / _INNER**2
    lumps = 0.006 * np.sin(31.0 * x + 3.0 * np.sin(17.0 * y)) * np.cos(27.0 * y + 2.0 * np.sin(19.0 * x))
    return np.asarray(SOIL + _MOUND * (1.0 - r2) + lumps)


def _pot(rng: np.random.Generator, foliage: Surface) -> tuple[Part, ...]:
    pot, saucer = (m.revolve([(r, z + FLOOR) for r, z in outline], 96) for outline in (_POT, _SAUCER))
    return (
        part("pot", pot, paint.pot()),
        part("saucer", saucer, paint.saucer()),
        part("soil", _soil(), paint.soil()),
        part("pebbles", _stones(rng), paint.pebbles()),
        part("fallen", _fallen(rng), foliage),
    )


def _soil() -> m.Mesh:
    outline = [(r, 0.0) for r in np.linspace(_INNER + 0.002, 0.0, 24)]
    disc = m.revolve(outline, 72)
    x, y = disc.vertices[:, 0], disc.vertices[:, 1]
    vertices = np.column_stack([x, y, ground(x, y)])
    return m.Mesh(vertices, disc.triangles, vertices[disc.triangles][..., :2] / (2.0 * _INNER) + 0.5)


def _stones(rng: np.random.Generator, count: int = 150) -> m.Mesh:
    feet = np.array([points[0][:2] for points, *_ in _STEMS])
    places: list[tuple[float, float, float]] = []
    for _ in range(40 * count):
        r, angle = (_INNER - 0.02) * np.sqrt(rng.uniform(0.05, 1.0)), rng.uniform(0.0, 2.0 * np.pi)
        size, x, y = rng.uniform(0.009, 0.022), r * np.cos(angle), r * np.sin(angle)
        clear = all((x - a) ** 2 + (y - b) ** 2 > (0.85 * (size + s)) ** 2 for a, b, s in places)
        if clear and np.hypot(*(feet - [x, y]).T).min() > 0.06 + size and r + size < _INNER - 0.004:
            places.append((x, y, size))
            if len(places) == count:
                break
    at = np.array(places)
    middles = np.column_stack([at[:, :2], ground(at[:, 0], at[:, 1]) + 0.22 * at[:, 2]])
    return pebbles(middles, at[:, 2], rng)


def _fallen(rng: np.random.Generator) -> m.Mesh:
    n = 5
    angle = np.array([0.5, 1.7, 2.9, 4.1, 5.4])
    r = np.array([0.2, 0.15, 0.21, 0.16, 0.19])
    frames = np.tile(np.eye(4), (n, 1, 1))
    turn = rng.uniform(0.0, 2.0 * np.pi, n)
    frames[:, 0, 0], frames[:, 1, 0], frames[:, 0, 1], frames[:, 1, 1] = (
        np.cos(turn), np.sin(turn), -np.sin(turn), np.cos(turn),
    )  # fmt: skip
    x, y = r * np.cos(angle), r * np.sin(angle)
    frames[:, :3, 3] = np.column_stack([x, y, ground(x, y) + 0.022])
    ones = np.ones(n)
    shapes = plants.Leaves(
        0.1 * ones, 0.045 * ones, 0.15 * ones, 0.15 * ones, 0.15 * ones, turn, np.full(n, 2 * paint.KINDS - 2)
    )
    return plants.blades(frames, shapes, paint.STRIPS)
