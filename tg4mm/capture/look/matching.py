"""Cells that move by more than a pixel: registered frame by frame (`tracking/registration.py`), patch by patch.

One picture is compared with all others at every whole offset up to `REACH`, over the whole patch that moves; then each
of its cells is refined by itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import ndimage

from tg4mm.capture.look.baseline import BLOCK, BaselineMisfit
from tg4mm.capture.tracking.registration import EDGE, TAPS, refined, whole_offsets
from tg4mm.capture.tracking.template import Grid

REACH = 8  # pixels, of an offset
FEWEST_CELLS = 4  # of a patch
_MARGIN = REACH + EDGE + TAPS  # pixels around a cell
_BEYOND = 0.05  # at most, at the end of the reach
_LEFT = 0.12  # of what changes, in all but a quarter of the cells: wheels and leaves leave more
_ROUNDS = 3  # of a cell,
_FAR_PX = 0.5  # more has come to no rest


@dataclass
class Patch:
    """Connected cells and the pixels around them in every picture."""

    cells: np.ndarray  # indices
    places: np.ndarray  # [C, 2] upper left corners in the box, pixels down and right
    size: int  # pixels of a cell
    rows: np.ndarray  # of the picture; edges are repeated
    columns: np.ndarray
    pictures: list[np.ndarray] = field(default_factory=list)  # [f, h, w]

    def keep(self, pictures: np.ndarray) -> None:
        """Keep the box of pictures [f, H, W]."""
        self.pictures.append(pictures[:, self.rows[:, None], self.columns])

    @property
    def size_bytes(self) -> int:
        return sum(p.nbytes for p in self.pictures)


@dataclass(frozen=True)
class Matched:
    """Measurements of some cells in each of F pictures, as in `reading.CellSeries`."""

    cells: np.ndarray
    shift: np.ndarray  # [F, C, 2]
    gain: np.ndarray  # [F, C]
    misfit: np.ndarray  # [F, C]
    covariance: np.ndarray  # [C, 2, 2]


def patches_of(chosen: np.ndarray, grid: Grid, shape: Sequence[int]) -> list[Patch]:
    """Connected cells of `chosen` [C] bool in pictures of a shape (height, width)."""
    labels, count = ndimage.label(grid.picture(chosen), BLOCK)
    out = []
    for k in range(1, count + 1):
        cells = np.flatnonzero(labels == k)
        if len(cells) < FEWEST_CELLS:
            continue
        left, upper, right, lower = grid.box(cells)
        rows = np.clip(np.arange(upper - _MARGIN, lower + _MARGIN), 0, shape[0] - 1)
        columns = np.clip(np.arange(left - _MARGIN, right + _MARGIN), 0, shape[1] - 1)
        corners = np.stack(np.divmod(cells, grid.columns), 1) * grid.size - [upper, left] + _MARGIN
        out.append(Patch(cells, corners, grid.size, rows, columns))
    return out


def matched(patch: Patch, baseline: BaselineMisfit, change: np.ndarray) -> Matched | None:
    """Return the cells of a patch that its motion explains better than a small shift; None if it moves otherwise.

    baseline: of all cells, by small shifts; change [C]: of all cells, the mean square of what no shift explains at all.
    A wheel's rim or a leaf in the wind resembles itself at some offset from time to time; if a patch moves as one, many
    cells always do.
    """
    pictures = np.concatenate(patch.pictures)
    inside = np.zeros(pictures.shape[1:], np.float32)
    for down, right in patch.places:
        inside[down : down + patch.size, right : right + patch.size] = 1
    start = whole_offsets(pictures, inside, REACH)
    if (np.abs(start) == REACH).any(1).mean() > _BEYOND:
        return None
    parts = [_cell(pictures, place, patch.size, start) for place in patch.places]
    shift, gain, misfit = (np.stack([part[k] for part in parts], 1) for k in range(3))
    before, left = baseline.typical[patch.cells], np.median(misfit, 0)
    all_of_it = change[patch.cells] - baseline.noise
    shares = (np.maximum(left - baseline.noise, 0) / np.maximum(all_of_it, 1e-9))[all_of_it > baseline.noise]
    if len(shares) and np.percentile(shares, 25) > _LEFT:
        return None
    is_better = (left < before) & np.array([part[4] for part in parts])
    covariance = np.stack([part[3] for part in parts])
    return Matched(
        patch.cells[is_better],
        shift[:, is_better],
        gain[:, is_better],
        misfit[:, is_better],
        covariance[is_better],
    )


def _cell(pictures: np.ndarray, place: np.ndarray, size: int, start: np.ndarray) -> tuple[Any, ...]:
    """Estimate the motion of the cell at a place, starting from offsets [F, 2].

    Returns shifts [F, 2], gains [F], misfits [F], the covariance [2, 2], and whether the iterations converged.
    """
    down, right = (slice(int(k) - _MARGIN, int(k) + size + _MARGIN) for k in place)
    start = np.clip(start, -REACH, REACH)
    inner = (slice(REACH + TAPS, -REACH - TAPS),) * 2
    cell = Grid(1, 1, size, EDGE)
    solved, template, furthest = refined(pictures[:, down, right], cell, start, inner, _ROUNDS)
    shift, gain, misfit, _ = (part[0] for part in solved)
    return shift, gain, misfit, template.covariance[0], furthest < _FAR_PX
