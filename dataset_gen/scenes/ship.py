"""The scene "ship": a three-masted wooden ship with furled sails in a round disc of sea, on which she rocks."""

from dataclasses import replace

import numpy as np

from ..meshes import Mesh
from ..scene import AreaLight, Gradient, Part, Scene, part
from ..shapes.scatter import patch
from . import ship_fittings as fittings
from . import ship_hull as hull
from . import ship_rigging as rigging
from . import ship_surfaces as paint
from .ship_fittings import HULL, WATER, WATER_RADIUS

_SCALE = 1.17  # of the plan, in which the ship is 2 units long and her middle lies forward of the origin
_SHIFT = np.array([-0.115, 0.0, 0.0])  # before scaling
_LEVEL = _SCALE * WATER


def swell(
    x: np.ndarray, y: np.ndarray, rng: np.random.Generator, waves: int = 14, height: float = 0.006
) -> np.ndarray:
    """Height of a short-crested sea at points, deviation `height`: sines that mostly run along +x, sharpened."""
    out = np.zeros(np.shape(x))
    for _ in range(waves):
        length = 0.09 * 7.0 ** rng.uniform()
        heading = rng.normal(0.4, 0.75)
        phase = 2.0 * np.pi * ((x * np.cos(heading) + y * np.sin(heading)) / length + rng.uniform())
        out += length**0.9 * (np.sin(phase) + 0.22 * np.cos(2.0 * phase))
    return np.asarray(
        out * height / (0.72 * np.sqrt(sum(0.09**1.8 * 7.0 ** (1.8 * k) for k in np.linspace(0, 1, waves))))
    )


def disc(
    radius: float, level: float, depth: float, rng: np.random.Generator, rings: int = 100, segments: int = 288
) -> tuple[Mesh, Mesh]:
    """The wavy surface, and the body below it (side and lens-shaped bottom).

    Surface: uv is the square around the disc. Body: u around, v from the bottom's middle up to the edge.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, segments + 1)
    r = radius * np.linspace(0.0, 1.0, rings)[:, None] ** 0.85
    x, y = r * np.cos(angle), r * np.sin(angle)
    top = np.stack([x, y, level + swell(x, y, rng)], -1)
    surface = patch(top, np.stack([x, y], -1) / (2.0 * radius) + 0.5)
    surface = _welded(surface, rings, segments)
    t = np.linspace(0.0, 1.0, 28)[:, None]  # a rounded shoulder, then the lens
    out = np.concatenate(
        [
            np.sin(0.5 * np.pi * t[:-8] / t[-8]) ** 0.8,
            1.0 + 0.012 * np.sin(np.pi * np.linspace(0.1, 1.0, 8))[:, None],
        ]
    )
    drop = np.concatenate(
        [1.0 - 0.45 * (1.0 - np.sqrt(1.0 - 0.98 * out[:-8] ** 4)), np.linspace(0.5, 0.0, 8)[:, None]]
    )
    z = level - depth * drop + (top[-1, :, 2] - level)[None] * (1.0 - drop)
    out[-1] = 1.0
    ring = np.stack([radius * out * np.cos(angle), radius * out * np.sin(angle), z], -1)
    return surface, patch(ring)


def _welded(mesh: Mesh, rings: int, segments: int) -> Mesh:
    """The seam's vertices and the pole's made one, so that normals are smooth there."""
    index = np.arange(rings * (segments + 1)).reshape(rings, segments + 1)
    index[:, -1] = index[:, 0]
    index[0] = index[0, 0]
    used, packed = np.unique(index, return_inverse=True)
    return Mesh(mesh.vertices[used], packed.reshape(-1)[mesh.triangles].astype(np.int32), mesh.uv)


def picture_points(radius: float, size: int) -> tuple[np.ndarray, np.ndarray]:
    """x and y [size, size] of the texels of the surface's picture."""
    c = ((np.arange(size) + 0.5) / size * 2.0 - 1.0) * radius
    x, y = np.meshgrid(c, c)
    return x, y


def distance_to(outline: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Distance of points to a symmetric waterline given by its starboard half [P, 2], y ≤ 0; 0 inside."""
    half = np.interp(x, outline[:, 0], -outline[:, 1], left=0.0, right=0.0)
    beyond = np.maximum(np.maximum(outline[0, 0] - x, x - outline[-1, 0]), 0.0)
    return np.hypot(beyond, np.maximum(np.abs(y) - half, 0.0))


def build() -> Scene:
    plan = (*hull.parts(), *fittings.parts(), *rigging.parts())
    ship = (replace(p, mesh=replace(p.mesh, vertices=(p.mesh.vertices + _SHIFT) * _SCALE)) for p in plan)
    return Scene(
        name="ship",
        parts=(*_sea(), *ship),
        lights=(AreaLight((2.6, -3.2, 3.8), 3.0, 190.0, (1.0, 0.93, 0.82)),),
        sky=Gradient(((0.16, 0.14, 0.13), (0.55, 0.55, 0.56), (0.75, 0.92, 1.2))),
    )


def _sea() -> tuple[Part, ...]:
    top, body = disc(WATER_RADIUS, _LEVEL, 0.225, _swell())
    x, y = picture_points(WATER_RADIUS, 768)
    stations = np.linspace(0.0, 1.0, 80)
    waterline = (HULL.side(stations, HULL.level(stations, WATER)) + _SHIFT) * _SCALE
    surface = paint.water(swell(x, y, _swell()), distance_to(waterline[:, :2], x, y))
    return part("water", top, surface), part("sea_body", body, paint.sea_body())


def _swell() -> np.random.Generator:
    return np.random.default_rng([2031, 0])
