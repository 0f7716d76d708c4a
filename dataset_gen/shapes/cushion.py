"""Upholstery: cushions over an outline given in polar form, tufts, mouldings and piping along the rim, nails."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..meshes import Mesh
from .sheet import edged, sheet

Surface3 = Callable[[np.ndarray], np.ndarray]  # plane points [..., 2] to points in space [..., 3]


@dataclass(frozen=True)
class Outline:
    """A star-shaped closed curve about the origin of a plane: a superellipse, wider at one side."""

    half_x: float
    half_y: float
    power: float = 3.5  # 2 is an ellipse; more has squarer corners
    taper: float = 0.0  # half_y grows by this share towards +x and shrinks towards −x
    shoulder: float = 0.0  # half_x grows by this share towards +y
    crest: float = 0.0  # a soft hump of this height in the middle of +y

    def radius(self, angle: np.ndarray) -> np.ndarray:
        """Distance of the curve from the origin at an angle from +x."""
        c, s = np.cos(angle), np.sin(angle)
        wide = self.half_y * (1.0 + self.taper * c)
        broad = self.half_x * (1.0 + self.shoulder * s)
        power = self.power
        reach = (np.abs(c / broad) ** power + np.abs(s / wide) ** power) ** (-1.0 / power)
        return reach + self.crest * np.exp(-((np.arctan2(c, s) / 0.33) ** 2))

    def rim(self, count: int, grow: float = 0.0) -> np.ndarray:
        """[count, 2] in equal steps along the curve, counter-clockwise from +x; `grow` pushes it outwards."""
        angle = np.linspace(0.0, 2.0 * np.pi, 2001)
        fine = (self.radius(angle) + grow)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1))])
        even = np.linspace(0.0, lengths[-1], count, endpoint=False)
        return np.column_stack([np.interp(even, lengths, fine[:, k]) for k in range(2)])

    def disc(self, count: int, sharpness: float = 0.6) -> tuple[np.ndarray, np.ndarray]:
        """Points [count, count, 2] that fill the outline, and their share [count, count] of the way to it.

        A square grid bent to a disc; the border of the grid is the outline.
        """
        p = edged(count, sharpness)
        q = p[:, None] * np.sqrt(1.0 - 0.5 * p[None] ** 2)
        r = np.broadcast_to(q.T, (count, count))
        share = np.minimum(np.hypot(r, q), 1.0)
        reach = share * self.radius(np.arctan2(q, r))
        size = np.maximum(np.hypot(r, q), 1e-9)
        return np.stack([r / size * reach, q / size * reach], -1), share


def tufts(points: np.ndarray, buttons: np.ndarray, pull: float, width: float, crease: float) -> np.ndarray:
    """How deep [...] buttons [N, 2] and the creases between neighbouring ones pull a cushion in at points [..., 2]."""
    gap = np.linalg.norm(buttons[:, None] - buttons[None], axis=2) + 9.0 * np.eye(len(buttons))
    depth = np.zeros(points.shape[:-1])
    for button in buttons:
        depth = np.maximum(depth, pull * np.exp(-np.linalg.norm(points - button, axis=-1) / width))
    for i, j in np.argwhere(np.triu(gap < 1.25 * gap.min())):
        along = buttons[j] - buttons[i]
        t = np.clip((points - buttons[i]) @ along / (along @ along), 0.0, 1.0)
        away = np.linalg.norm(points - buttons[i] - t[..., None] * along, axis=-1)
        depth = np.maximum(depth, crease * np.exp(-away / (0.35 * width)))
    return depth


def diamonds(
    rows: int, columns: int, spacing: tuple[float, float], middle: tuple[float, float]
) -> np.ndarray:
    """Buttons [N, 2] in staggered rows; every second row has one fewer."""
    made = []
    for r in range(rows):
        n = columns - r % 2
        across = (np.arange(n) - (n - 1) / 2.0) * spacing[1]
        made += [(middle[0] + (r - (rows - 1) / 2.0) * spacing[0], middle[1] + a) for a in across]
    return np.array(made)


def moulding(
    path: np.ndarray,  # [P, 3] a closed curve, its start not repeated
    outward: np.ndarray,  # [P, 3] unit directions of the section's x axis
    normal: np.ndarray,  # [P, 3] unit directions of the section's y axis
    section: np.ndarray,  # [S, 2] counter-clockwise
    swell: np.ndarray | None = None,  # [P] scale of the section
) -> Mesh:
    """A section carried round a closed curve with directions that are given. u around the section, v along."""
    tangent = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0)
    if (np.cross(outward, normal) * tangent).sum() < 0.0:
        section = section[::-1]
    size = np.ones(len(path)) if swell is None else swell
    rings = path[:, None] + size[:, None, None] * (
        section[None, :, :1] * outward[:, None] + section[None, :, 1:] * normal[:, None]
    )
    return sheet(np.concatenate([rings, rings[:1]]), around=True)


def frames_on(surface: Surface3, rim: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, outward directions and normals, each [P, 3], of a closed plane curve laid on a surface in space."""
    h = 1e-4
    point = surface(rim)
    step = np.roll(rim, -1, axis=0) - np.roll(rim, 1, axis=0)
    step /= np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-12)
    step = np.where(np.abs(step).max(1, keepdims=True) > 0.0, step, [0.0, 1.0])  # of a single point
    tangent = surface(rim + h * step) - surface(rim - h * step)
    a = surface(rim + [h, 0.0]) - point
    b = surface(rim + [0.0, h]) - point
    normal = np.cross(a, b)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    outward = np.cross(tangent, normal)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    return point, outward, normal


def bead_section(
    width: float, height: float, grooves: int = 0, depth: float = 0.0, count: int = 40
) -> np.ndarray:
    """Section [S, 2] of a carved rail: a soft rectangle, with grooves cut round it."""
    angle = 2.0 * np.pi * np.arange(count) / count
    c, s = np.cos(angle), np.sin(angle)
    reach = (np.abs(c) ** 3.5 + np.abs(s) ** 3.5) ** (-1.0 / 3.5)
    if grooves:
        reach = reach * (1.0 - depth * (0.5 - 0.5 * np.cos(grooves * angle)) ** 4)
    return 0.5 * reach[:, None] * np.column_stack([width * c, height * s])
