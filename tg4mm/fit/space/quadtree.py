"""Squares on a picture: fine ones where it has detail, coarse ones elsewhere."""

from dataclasses import dataclass

import numpy as np

FINEST, COARSEST = 2, 32  # cells' sides, pixels
DETAIL = 0.5 / 255  # rms: a cell of less is not split, it holds what rounding and noise left


@dataclass(frozen=True)
class Cells:
    """Squares on a picture; those at its right and lower edge may reach over it."""

    centres: np.ndarray  # [N, 2] pixels
    sides: np.ndarray  # [N] pixels, powers of two
    colours: np.ndarray  # [N, 3] mean over the cell; what lies outside repeats the edge


def quadtree(picture: np.ndarray, budget: int, coarsest: int = COARSEST) -> Cells:
    """At most `budget` cells (or as many as there are of the coarsest): all nodes of the tree, the coarsest first.

    picture: [H, W, 3]. A cell is split while its squared deviation, summed over pixels and channels, is among the
    largest and above noise; it stays below its children. These deviate less than it does, all four together, so one
    threshold serves all sizes.
    """
    height, width = picture.shape[:2]
    levels = _pyramid(picture, coarsest)
    deviations = np.sort(np.concatenate([sums.ravel() for _, _, sums in levels[:-1]]))[::-1]
    splits = max(budget - levels[0][2].size, 0) // 4
    threshold = deviations[splits] if splits < len(deviations) else 0.0
    active = np.ones(levels[0][2].shape, bool)
    found = []
    for side, means, sums in levels:
        above = sums > max(threshold, 3 * side**2 * DETAIL**2)
        split = active & above & (side > FINEST)
        rows, columns = np.nonzero(active)
        centres = np.stack([columns + 0.5, rows + 0.5], 1) * side
        found.append((centres, np.full(len(rows), side), means[rows, columns]))
        active = split.repeat(2, 0).repeat(2, 1)
    centres, sides, colours = (np.concatenate(parts) for parts in zip(*found, strict=True))
    inside = (centres - sides[:, None] / 2 < [width, height]).all(1)
    return Cells(centres[inside], sides[inside], colours[inside])


def _pyramid(picture: np.ndarray, coarsest: int) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Side, means [h, w, 3] and summed squared deviations [h, w] of cells of every size, the coarsest first."""
    height, width = picture.shape[:2]
    missing = (-height % coarsest, -width % coarsest)
    padded = np.pad(picture.astype(np.float64), (*((0, m) for m in missing), (0, 0)), mode="edge")
    sums, squares, side = padded, (padded**2).sum(-1), 1
    levels = []
    while side < coarsest:
        sums, squares, side = _fours(sums), _fours(squares), 2 * side
        if side >= FINEST:
            means = sums / side**2
            levels.append((side, means, np.maximum(squares - side**2 * (means**2).sum(-1), 0.0)))
    return levels[::-1]


def _fours(a: np.ndarray) -> np.ndarray:
    """Sums over 2 × 2 blocks of the first two axes."""
    rows = a[::2] + a[1::2]
    return np.asarray(rows[:, ::2] + rows[:, 1::2])
