"""Cells that move by more than a pixel: every picture is matched by whole pixels, then solved as the other cells are.

The mean picture of such a cell is smeared, and no small shift explains what it shows. So one picture is compared with
all others at every whole offset up to `REACH` (least squares over the whole patch that moves), each cell is cut out of
each picture where it has moved to, and `cells.Template` gives what is left; so again, twice.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import fft, ndimage
from scipy.signal import fftconvolve

from tg4mm.capture.look.cells import Grid, Template
from tg4mm.capture.look.usual import BLOCK, Usual

REACH = 8  # pixels, of an offset
FEWEST_CELLS = 4  # of a patch
_EDGE = 10  # pixels around a cell that slopes of its mean need,
_TAPS = 7  # and around these, for points between pixels
_MARGIN = REACH + _EDGE + _TAPS
_WIDEST = 256  # pixels a side of what offsets are sought by
_BEYOND = 0.05  # at most, at the end of the reach
_LEFT = 0.12  # of what changes, in all but a quarter of the cells: wheels and leaves leave more
_ROUNDS = 3  # of a cell,
_NEAR_PX = 0.1  # fewer where less is left of most shifts
_FAR_PX = 0.5  # more has come to no rest


@dataclass
class Patch:
    """Cells beside each other, and the pixels around them of every picture."""

    cells: np.ndarray  # indices
    places: np.ndarray  # [C, 2] upper left corners in the box, pixels down and right
    size: int  # pixels of a cell
    rows: np.ndarray  # of the picture; edges are repeated
    columns: np.ndarray
    pictures: list[np.ndarray] = field(default_factory=list)  # [f, h, w]

    def keep(self, pictures: np.ndarray) -> None:
        """Takes the box out of pictures [f, H, W]."""
        self.pictures.append(pictures[:, self.rows[:, None], self.columns])

    @property
    def size_bytes(self) -> int:
        return sum(p.nbytes for p in self.pictures)


@dataclass(frozen=True)
class Matched:
    """What some cells show in each of F pictures, as `reading.CellSeries` has it."""

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


def matched(patch: Patch, usual: Usual, change: np.ndarray) -> Matched | None:
    """Cells of a patch that their own motion explains better than a small shift does; None where it moves otherwise.

    usual: of all cells, by small shifts; change [C]: of all cells, the mean square of what no shift explains at all.
    A wheel's rim or a leaf in the wind is like itself now and then at some offset; of what moves as one, many cells are
    so always.
    """
    pictures = np.concatenate(patch.pictures)
    start = _offsets(pictures, patch)
    if (np.abs(start) == REACH).any(1).mean() > _BEYOND:
        return None
    parts = [_cell(pictures, place, patch.size, start) for place in patch.places]
    shift, gain, misfit = (np.stack([part[k] for part in parts], 1) for k in range(3))
    before, left = usual.typical[patch.cells], np.median(misfit, 0)
    all_of_it = change[patch.cells] - usual.noise
    shares = (np.maximum(left - usual.noise, 0) / np.maximum(all_of_it, 1e-9))[all_of_it > usual.noise]
    if len(shares) and np.percentile(shares, 25) > _LEFT:
        return None
    own = (left < before) & np.array([part[4] for part in parts])
    covariance = np.stack([part[3] for part in parts])
    return Matched(patch.cells[own], shift[:, own], gain[:, own], misfit[:, own], covariance[own])


def _offsets(pictures: np.ndarray, patch: Patch) -> np.ndarray:
    """[F, 2] whole pixels right and down that a patch has moved by since the first picture."""
    inside = np.zeros(pictures.shape[1:], np.float32)
    for down, right in patch.places:
        inside[down : down + patch.size, right : right + patch.size] = 1
    first = pictures[0].astype(np.float32)
    box = _widest(first, inside)
    inside, first = inside[box], first[box]
    inside[:REACH] = inside[-REACH:] = inside[:, :REACH] = inside[:, -REACH:] = 0
    level = float(first.mean(where=inside > 0)) if inside.any() else 0.0
    first = (first - level) * inside
    shape = inside.shape
    of_first, of_inside = np.conj(fft.rfft2(first)), np.conj(fft.rfft2(inside))
    near = np.arange(-REACH, REACH + 1)
    out = np.empty((len(pictures), 2), int)
    for k, picture in enumerate(pictures):
        own = picture[box].astype(np.float32) - level
        unlike = fft.irfft2(of_inside * fft.rfft2(own * own) - 2 * of_first * fft.rfft2(own), shape)
        down, right = np.divmod(int(unlike[near[:, None], near].argmin()), len(near))
        out[k] = right - REACH, down - REACH
    return out


def _widest(picture: np.ndarray, inside: np.ndarray) -> tuple[slice, slice]:
    """The part of a box, of limited size, in which the patch has most texture."""
    down, right = np.gradient(picture)
    sides = [min(n - 2 * REACH, _WIDEST) for n in picture.shape]
    sums = fftconvolve((down**2 + right**2) * inside, np.ones(sides, np.float32), mode="valid")
    corner = np.unravel_index(
        int(sums[REACH:-REACH, REACH:-REACH].argmax()), np.array(sums.shape) - 2 * REACH
    )
    first, second = (slice(int(c), int(c) + n + 2 * REACH) for c, n in zip(corner, sides, strict=True))
    return first, second


def _cell(pictures: np.ndarray, place: np.ndarray, size: int, start: np.ndarray) -> tuple[np.ndarray, ...]:
    """Estimate the motion of the cell at a place, starting from offsets [F, 2].

    Returns shifts [F, 2], gains [F], misfits [F], the covariance [2, 2], and whether the iterations converged.
    """
    around = _EDGE + _TAPS
    side = size + 2 * around
    windows = np.lib.stride_tricks.sliding_window_view(pictures, (1, side, side))[:, :, :, 0]
    grid, shift, every = Grid(1, 1, size, _EDGE), start.astype(float), np.arange(len(pictures))
    for _ in range(_ROUNDS):
        before = np.clip(np.nan_to_num(shift), -REACH, REACH)
        whole = np.rint(before).astype(int)
        tiles = windows[every, place[0] - around + whole[:, 1], place[1] - around + whole[:, 0]]
        tiles = _sampled(tiles, before - whole)
        template = Template(tiles.mean(0), grid)
        left, gain, misfit, _ = (part[0] for part in template.solved(*template.products(tiles)))
        shift = before + left
        furthest = np.nanpercentile(np.abs(left), 95)
        if furthest < _NEAR_PX:
            break
    return shift, gain, misfit, template.covariance[0], furthest < _FAR_PX


def _sampled(tiles: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Tiles [F, h, w] at points that lie by a fraction of a pixel further right and down, smaller by the taps.

    By a sinc under a Hann window; at: [F, 2] pixels, −½ … ½.
    """
    out, taps = tiles.astype(np.float32), np.arange(-_TAPS, _TAPS + 1)
    for fraction in (at[:, 1], at[:, 0]):
        away = taps - fraction[:, None]
        kernel = np.sinc(away) * np.cos(np.pi * away / (2 * _TAPS + 2)) ** 2
        kernel /= kernel.sum(1, keepdims=True)
        inside = out.shape[1] - 2 * _TAPS
        matrix = np.zeros((len(out), inside, out.shape[1]), np.float32)
        for k in range(inside):
            matrix[:, k, k : k + len(taps)] = kernel
        out = (matrix @ out).transpose(0, 2, 1)
    return out
