"""Where every texel of an unrolled surface lies in space, so that patterns in space can be painted on it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def _centres(count: int) -> np.ndarray:
    return (np.arange(count) + 0.5) / count


def of_grid(points: np.ndarray, height: int, width: int) -> np.ndarray:
    """[H, W, 3] from a grid of points [R, S, 3] with u over its columns and v over its rows: bilinear."""
    rows, columns = points.shape[:2]
    r, s = _centres(height) * (rows - 1), _centres(width) * (columns - 1)
    i, j = np.minimum(r.astype(int), rows - 2), np.minimum(s.astype(int), columns - 2)
    tr, ts = (r - i)[:, None, None], (s - j)[None, :, None]
    tall = points[i] * (1.0 - tr) + points[i + 1] * tr
    return (tall[:, j] * (1.0 - ts) + tall[:, j + 1] * ts).astype(np.float32)


def of_revolved(outline: Sequence[Sequence[float]], height: int, width: int) -> np.ndarray:
    """[H, W, 3] of a surface that `meshes.revolve` makes of the same outline (radius, z)."""
    path = np.asarray(outline, float)
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    v = _centres(height) * lengths[-1]
    radius, z = np.interp(v, lengths, path[:, 0])[:, None], np.interp(v, lengths, path[:, 1])[:, None]
    angle = 2.0 * np.pi * _centres(width)[None]
    points = [radius * np.cos(angle), radius * np.sin(angle), np.broadcast_to(z, (height, width))]
    return np.stack(points, -1).astype(np.float32)


def of_tube(radius: float, length: float, height: int, width: int) -> np.ndarray:
    """[H, W, 3] of a straight tube along z: stands for a swept one, whose bends a pattern should follow."""
    return of_revolved([(radius, 0.0), (radius, length)], height, width)


def of_ball(height: int, width: int) -> np.ndarray:
    """[H, W, 3] on the unit sphere, for a ball revolved from its south to its north pole."""
    angle = np.pi * (_centres(height)[:, None] - 0.5)
    turn = 2.0 * np.pi * _centres(width)[None]
    flat = np.cos(angle)
    points = [flat * np.cos(turn), flat * np.sin(turn), np.broadcast_to(np.sin(angle), (height, width))]
    return np.stack(points, -1).astype(np.float32)
