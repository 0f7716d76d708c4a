"""Registration for larger motion: frames are aligned to their mean, which is taken again, until little is left.

The mean of frames that move by more than a third of a pixel is blurred, and no small shift explains the differences. So
where the motion may exceed a pixel, integer offsets are found first (least squares over every offset in range); then
the frames are resampled by the motion found so far, and `template.Template` gives the rest against their mean.
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from scipy import fft
from scipy.signal import fftconvolve

from tg4mm.capture.tracking.template import Parts, Solved, Template, Turn

TAPS = 7  # pixels to either side that a point between pixels is interpolated from
EDGE = 12  # pixels around a part that third derivatives of its mean need
ROUNDS = 4  # at most
NEAR_PX = 0.1  # no further round where less is left of most shifts
AT_END = 0.05  # of the frames, at most, at the end of the reach
Box = tuple[slice, slice]  # rows and columns of a picture
_WIDEST = 256  # pixels a side of the picture that offsets are sought by


def whole_offsets(pictures: np.ndarray, inside: np.ndarray, reach: int) -> np.ndarray:
    """Return [F, 2] whole pixels right and down that a part has moved by since the first picture, `reach` at most.

    pictures [F, h, w], which extend at least `reach` beyond the part; inside [h, w]: 1 in the part, 0 elsewhere.
    """
    first, inside = pictures[0].astype(np.float32), inside.astype(np.float32)
    box = _most_textured(first, inside, reach)
    inside, first = inside[box].copy(), first[box]
    inside[:reach] = inside[-reach:] = inside[:, :reach] = inside[:, -reach:] = 0
    level = float(first.mean(where=inside > 0)) if inside.any() else 0.0
    first = (first - level) * inside
    shape = inside.shape
    of_first, of_inside = np.conj(fft.rfft2(first)), np.conj(fft.rfft2(inside))
    near = np.arange(-reach, reach + 1)
    out = np.empty((len(pictures), 2), int)
    for k, picture in enumerate(pictures):
        cut = picture[box].astype(np.float32) - level
        unlike = fft.irfft2(of_inside * fft.rfft2(cut * cut) - 2 * of_first * fft.rfft2(cut), shape)
        down, right = np.divmod(int(unlike[near[:, None], near].argmin()), len(near))
        out[k] = right - reach, down - reach
    return out


def _most_textured(picture: np.ndarray, inside: np.ndarray, reach: int) -> tuple[slice, slice]:
    """The window, of limited size, in which the part has most texture."""
    down, right = np.gradient(picture)
    sides = [min(n - 2 * reach, _WIDEST) for n in picture.shape]
    if all(side == n - 2 * reach for side, n in zip(sides, picture.shape, strict=True)):
        return slice(None), slice(None)
    sums = fftconvolve((down**2 + right**2) * inside, np.ones(sides, np.float32), mode="valid")
    corner = np.unravel_index(
        int(sums[reach:-reach, reach:-reach].argmax()), np.array(sums.shape) - 2 * reach
    )
    first, second = (slice(int(c), int(c) + n + 2 * reach) for c, n in zip(corner, sides, strict=True))
    return first, second


class ReadoutClock(Protocol):
    """Times of the rows of frames."""

    def by_row(self, shift: np.ndarray) -> np.ndarray:
        """Return shifts [F, h, 2] of every row for those [F, 2] of a part as a whole."""
        ...

    def products(self, template: Template, pictures: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return `Template.products`, all rows at the time of the part as a whole."""
        ...


def refined(
    pictures: np.ndarray,
    parts: Parts,
    start: np.ndarray,
    inner: Box,
    rounds: int = ROUNDS,
    turn: Turn | None = None,
    clock: ReadoutClock | None = None,
) -> tuple[Solved, Template, float]:
    """Iterate the shift of parts that move as one in pictures [F, h, w], from `start` [F, 2] on, pixels right and down.

    inner: the rows and columns of the pictures that the parts lie in; around it frames are read where it has moved to.
    clock: row times; None: all rows at once. Returns each part's motion, the template of the last round, and the
    remaining shift of most frames in it (pixels).
    """
    whole = start.astype(float)
    for _ in range(rounds):
        before = np.nan_to_num(whole)
        by_row = before[:, None] if clock is None else clock.by_row(before)
        registered = resampled(pictures, by_row, inner)
        template = Template(registered.mean(0), parts, turn)
        products = template.products(registered) if clock is None else clock.products(template, registered)
        solved = template.solved(*products)
        left = template.together(solved.shift)
        whole, furthest = before + left, float(np.nanpercentile(np.abs(left), 95))
        if furthest < NEAR_PX:
            break
    moved = solved.shift.copy()
    moved[..., :2] += before
    return solved._replace(shift=moved), template, furthest


def resampled(pictures: np.ndarray, shift: np.ndarray, inner: Box) -> np.ndarray:
    """Return a box [F, h, w] of pictures moved back by shifts [F, h or 1, 2] of its rows, pixels right and down.

    By a sinc under a Hann window. Beyond the edge a picture is continued by its edge.
    """
    from tg4mm.capture.tracking.kernels import resample  # numba takes a second, and small motion needs none

    rows, columns = (range(n)[part] for n, part in zip(pictures.shape[1:], inner, strict=True))
    out = np.empty((len(pictures), len(rows), len(columns)), np.float32)
    resample(pictures, np.ascontiguousarray(shift, np.float64), rows.start, columns.start, TAPS, out)
    return out


def spread(series: np.ndarray) -> float:
    """Return the distance of most of a series [F, 2] from its median, pixels."""
    away = np.abs(series - np.nanmedian(series, 0))
    return float(np.nanpercentile(away, 95)) if np.isfinite(away).any() else 0.0


def offsets_within(pictures: np.ndarray, inside: np.ndarray, reaches: Sequence[int]) -> np.ndarray | None:
    """`whole_offsets` within the smallest of several limits that few of them reach; None if all are too small."""
    for reach in reaches:
        found = whole_offsets(pictures, inside, reach)
        if (np.abs(found) == reach).any(1).mean() <= AT_END:
            return found
    return None
