"""Patterns in space, painted where a surface lies: noise, cells, veins, ramps. No seams and no pinched poles.

Points are [..., 3] in scene units; a pattern is [...]. Values do not depend on how the surface is unrolled.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

_VOLUME = 64  # voxels per edge of the periodic noise
_VOLUMES = 3  # different ones; further seeds look elsewhere in the same three
_GRAIN = 20.0  # waves per edge: a wave is some three voxels, so that linear interpolation stays smooth


@lru_cache(maxsize=_VOLUMES)
def _volume(seed: int) -> np.ndarray:
    """Periodic smooth noise [64³] float32, mean 0, deviation 1."""
    n = _VOLUME
    spectrum = np.fft.rfftn(np.random.default_rng([77, seed]).standard_normal((n, n, n)))
    full, half = np.fft.fftfreq(n) * n / _GRAIN, np.fft.rfftfreq(n) * n / _GRAIN
    square = full[:, None, None] ** 2 + full[None, :, None] ** 2 + half[None, None] ** 2
    field = np.fft.irfftn(spectrum * np.exp(-2.0 * square), s=(n, n, n), axes=(0, 1, 2))
    return ((field - field.mean()) / field.std()).astype(np.float32).ravel()


def noise(points: np.ndarray, frequency: float | Sequence[float] | np.ndarray, seed: int = 0) -> np.ndarray:
    """Smooth noise, mean 0, deviation 1.

    `frequency`: of its finest waves, per scene unit, one number or one per axis; the bulk are some three times as long.
    """
    n = _VOLUME
    where = np.asarray(points, np.float32) * np.asarray(frequency, np.float32) * np.float32(n / _GRAIN)
    where = where + np.array([17.3, 29.1, 41.7], np.float32) * np.float32(seed // _VOLUMES)
    low = np.floor(where).astype(np.int32)
    t = where - low
    t = t * t * (3.0 - 2.0 * t)
    i, j = low % n, (low + 1) % n
    volume = _volume(seed % _VOLUMES)
    x0, x1 = i[..., 0] * (n * n), j[..., 0] * (n * n)
    y0, y1 = i[..., 1] * n, j[..., 1] * n
    z0, z1 = i[..., 2], j[..., 2]
    tx, ty, tz = t[..., 0], t[..., 1], t[..., 2]

    def row(xy: np.ndarray) -> np.ndarray:
        a = volume[xy + z0]
        return a + tz * (volume[xy + z1] - a)

    near, far = row(x0 + y0), row(x1 + y0)
    near = near + ty * (row(x0 + y1) - near)
    far = far + ty * (row(x1 + y1) - far)
    return near + tx * (far - near)


def fractal(
    points: np.ndarray,
    frequency: float | Sequence[float],
    octaves: int = 3,
    seed: int = 0,
    gain: float = 0.55,
) -> np.ndarray:
    """Octaves of noise, each twice as fine and `gain` times as strong; deviation about 1."""
    total = np.zeros(points.shape[:-1], np.float32)
    base = np.asarray(frequency, float)
    for k in range(octaves):
        total += gain**k * noise(points + 0.37 * k, base * 2.03**k, seed)
    return total / np.sqrt((gain ** (2.0 * np.arange(octaves))).sum())


@lru_cache(maxsize=8)
def _scattered(seed: int, jitter: float) -> tuple[np.ndarray, ...]:
    """One random point per cell of a periodic lattice of 32³, and a random label: four arrays [32³]."""
    table = np.random.default_rng([78, seed]).random((4, 32**3), np.float32)
    table[:3] = 0.5 + np.float32(jitter) * (table[:3] - 0.5)
    return tuple(table)


def _nearest(
    points: np.ndarray, frequency: float, seed: int, jitter: float, shift: float, reach: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First and second squared distance and label among reach³ cells, the lowest of them at floor(p − shift)."""
    where = [np.asarray(points[..., k], np.float32) * np.float32(frequency) for k in range(3)]
    low = [np.floor(w - np.float32(shift)).astype(np.int32) for w in where]
    inside = [w - c for w, c in zip(where, low, strict=True)]
    # Per axis and step, once: the cell's share of the index.
    strides = (1024, 32, 1)
    index = [[((c + k) & 31) * n for k in range(reach)] for c, n in zip(low, strides, strict=True)]
    x, y, z, label = _scattered(seed, jitter)
    first = np.full(low[0].shape, 9.0, np.float32)
    second, nearest = first.copy(), np.zeros(low[0].shape, np.int32)
    for i, j, k in np.ndindex(reach, reach, reach):
        cell = index[0][i] + index[1][j] + index[2][k]
        distance = (x[cell] + i - inside[0]) ** 2
        distance += (y[cell] + j - inside[1]) ** 2
        distance += (z[cell] + k - inside[2]) ** 2
        np.minimum(second, np.maximum(first, distance), out=second)
        np.copyto(nearest, cell, where=distance < first)
        np.minimum(first, distance, out=first)
    return first, second, label[nearest]


def cells(
    points: np.ndarray, frequency: float, seed: int = 0, jitter: float = 1.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Worley cells: distances to the nearest and second-nearest seed (in cells), and a random number per cell."""
    first, second, label = _nearest(points, frequency, seed, jitter, 1.0, 3)
    return np.sqrt(first), np.sqrt(second), label


def spots(points: np.ndarray, frequency: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Distance to the nearest of scattered points, in cells, right where it is below ½, and its random number.

    Three times as fast as `cells`: for pores, pepper, specks.
    """
    first, _, label = _nearest(points, frequency, seed, 1.0, 0.5, 2)
    return np.sqrt(first), label


def ramp(value: np.ndarray, stops: Sequence[tuple[float, tuple[float, float, float]]]) -> np.ndarray:
    """Colours [..., 3] of values: linear between the stops (value, sRGB colour), constant beyond."""
    at = [s[0] for s in stops]
    return np.stack([np.interp(value, at, [s[1][k] for s in stops]) for k in range(3)], -1)


def step(value: np.ndarray, low: float | np.ndarray, high: float | np.ndarray) -> np.ndarray:
    """0 below `low`, 1 above `high`, smooth between; falls if low > high."""
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def mix(first: np.ndarray, second: np.ndarray | tuple[float, float, float], weight: np.ndarray) -> np.ndarray:
    """`first` where the weight [...] is 0, `second` where it is 1."""
    w = weight[..., None]
    return first * (1.0 - w) + np.asarray(second) * w


def unit(value: np.ndarray) -> np.ndarray:
    """Clipped to 0..1."""
    return np.clip(value, 0.0, 1.0)


def _centres(count: int) -> np.ndarray:
    return (np.arange(count) + 0.5) / count


def of_grid(points: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return [H, W, 3] from a grid of points [R, S, 3] with u over its columns and v over its rows: bilinear."""
    rows, columns = points.shape[:2]
    r, s = _centres(height) * (rows - 1), _centres(width) * (columns - 1)
    i, j = np.minimum(r.astype(int), rows - 2), np.minimum(s.astype(int), columns - 2)
    tr, ts = (r - i)[:, None, None], (s - j)[None, :, None]
    tall = points[i] * (1.0 - tr) + points[i + 1] * tr
    return (tall[:, j] * (1.0 - ts) + tall[:, j + 1] * ts).astype(np.float32)


def of_revolved(outline: Sequence[Sequence[float]], height: int, width: int) -> np.ndarray:
    """Return [H, W, 3] of a surface that `meshes.revolve` makes of the same outline (radius, z)."""
    path = np.asarray(outline, float)
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    v = _centres(height) * lengths[-1]
    radius, z = np.interp(v, lengths, path[:, 0])[:, None], np.interp(v, lengths, path[:, 1])[:, None]
    angle = 2.0 * np.pi * _centres(width)[None]
    points = [radius * np.cos(angle), radius * np.sin(angle), np.broadcast_to(z, (height, width))]
    return np.stack(points, -1).astype(np.float32)


def of_tube(radius: float, length: float, height: int, width: int) -> np.ndarray:
    """Return [H, W, 3] of a straight tube along z: stands for a swept one, whose bends a pattern should follow."""
    return of_revolved([(radius, 0.0), (radius, length)], height, width)


def of_ball(height: int, width: int) -> np.ndarray:
    """Return [H, W, 3] on the unit sphere, for a ball revolved from its south to its north pole."""
    angle = np.pi * (_centres(height)[:, None] - 0.5)
    turn = 2.0 * np.pi * _centres(width)[None]
    flat = np.cos(angle)
    points = [flat * np.cos(turn), flat * np.sin(turn), np.broadcast_to(np.sin(angle), (height, width))]
    return np.stack(points, -1).astype(np.float32)
