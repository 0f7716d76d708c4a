"""Leaves in numbers: curved blades as thin closed shells, and the stalks that hold them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..meshes import Mesh

_ALONG, _ACROSS = 10, 5  # points of a blade; odd across: the midrib has its own row
_THICK = 0.0011  # half the thickness at the midrib, scene units


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
    """[F, 3] of one sheet, without those that vanish at base and tip; normals along −z."""
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
