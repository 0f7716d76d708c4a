"""Folds of the observations and their agreement: noise is attenuated, and every Gaussian gets a standard deviation.

Noise is independent between halves of the data, motion is the same in both. So the data are fitted in two halves, with
half of the prior's weight each. Where the halves' fields a and b agree, their mean u is kept; where they do not, it is
reduced by the gain with the least mean error (Wiener): Σ a·b / Σ |u|², one for each temporal component. Errors of the
prior are alike in both halves and remain.

Six cameras or more are halved by camera. Fewer are halved by pixels, in squares as on a chessboard, so that noise and
traces of a codec (macroblocks of 16 pixels) are independent. A moving camera's frames are halved by time.
"""

import numpy as np

from tg4mm.fit.motion.solver.operator import Fold

LEAST = 6  # cameras: fewer than three in a half do not hold a field in space
_AT_ONCE = 1 << 14  # Gaussians whose neighbourhoods are averaged together
_SQUARE = 16  # pixels: side of a square of the chessboard, and a codec's macroblock


def folds_of(n_views: int, size: tuple[int, int], is_moving: bool, split: bool = True) -> list[Fold]:
    """Two halves of `n_views` views of (width, height); one fold of everything unless `split`."""
    rows = np.arange(n_views)
    if not split:
        return [Fold(rows)]
    if is_moving:
        middle = n_views // 2
        return [Fold(rows[:middle]), Fold(rows[middle:])]
    if n_views >= LEAST:
        return [Fold(rows[::2]), Fold(rows[1::2])]
    board = chessboard(size)
    return [Fold(rows, board), Fold(rows, 1 - board)]


def chessboard(size: tuple[int, int]) -> np.ndarray:
    """Return [H, W] float32 of 0 and 1 in squares of 16 pixels (fewer in small pictures); size is (width, height)."""
    side = max(min(_SQUARE, min(size) // 16), 1)
    x, y = (np.arange(n) // side for n in size)
    return ((x[None] + y[:, None]) % 2).astype(np.float32)


def reliability(mean: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the Wiener gain [R] float32, 0 to 1, of the mean of two fields [R, N, 3] fitted to one half each."""
    both = np.einsum("rnc,rnc->r", a, b, dtype=np.float64)
    power = np.einsum("rnc,rnc->r", mean, mean, dtype=np.float64)
    return np.clip(both / np.maximum(power, np.finfo(np.float32).tiny), 0, 1).astype(np.float32)


def wiener_shrink(folds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the fields [R, N, 6] on which one fold or two halves [P, R, N, 6] agree, and gains [R]."""
    if len(folds) == 1:
        return folds[0], np.ones(folds.shape[1], np.float32)
    mean = (folds[0] + folds[1]) / 2
    gain = reliability(mean[..., :3], folds[0][..., :3], folds[1][..., :3])
    return mean * gain[:, None, None], gain


def deviation(a: np.ndarray, b: np.ndarray, knn: np.ndarray) -> np.ndarray:
    """Return the standard deviation [N] float32, scene units, of the noise in R fields together, from halves [R, N, 3].

    Rms over the nearest Gaussians `knn` of each [N, count]; of vectors' lengths, root of the sum over components,
    before any gain. Errors that both halves share are not in it.
    """
    spread = np.einsum("rnc,rnc->n", a - b, a - b) / 4
    return np.sqrt(mean_over_neighbours(spread, knn)).astype(np.float32)


def mean_over_neighbours(values: np.ndarray, knn: np.ndarray) -> np.ndarray:
    """Return means of values [N, …] over each Gaussian's nearest ones, listed [N, count] as by `Graph.knn`."""
    out = np.empty_like(values)
    for first in range(0, len(values), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        out[some] = values[knn[some]].mean(1)
    return out


def local_reliability(mean: np.ndarray, a: np.ndarray, b: np.ndarray, knn: np.ndarray) -> np.ndarray:
    """Return [R, N] float32, 0 to 1: `reliability` over the nearest Gaussians of each, of components [R, N, K, 3]."""
    both, power = (np.einsum("rnkc,rnkc->nr", *pair) for pair in ((a, b), (mean, mean)))
    both, power = np.split(mean_over_neighbours(np.concatenate([both, power], 1), knn).T, 2)
    return np.clip(both / np.maximum(power, np.finfo(np.float32).tiny), 0, 1)
