"""One pass over the pictures: every cell's shift, gain and misfit in each of them."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from tg4mm.capture.cameras import check_picture_size
from tg4mm.capture.frames import read_ahead
from tg4mm.capture.look.baseline import BaselineMisfit, baseline_of
from tg4mm.capture.look.matching import Patch, matched, patches_of
from tg4mm.capture.tracking.template import Grid, Template
from tg4mm.core.errors import CaptureError

FEWEST = 24  # pictures: fewer hold no spectrum
SMALL = 400_000  # pixels of a picture up to which cells are
CELL, LARGE_CELL = 16, 48  # pixels a side; above it
MEAN_OF = 256  # pictures, at most, that the mean is of
_FIRST_BYTES = 512 << 20  # and bytes
_MATCHED_BYTES = 1 << 30  # of the pixels around cells that move by more than a pixel
_FAR_PX = 0.5  # from the whole picture's shift, that third order in a shift does not hold
_CLEAR = 4.0  # deviations of a shift's noise that it must exceed, too
_AT_ONCE, _PIXELS_AT_ONCE = 32, 1 << 26  # pictures that are compared with the mean, at most
_KNOCK_PX = 0.5  # a step of the whole picture that stays
_SHORTEST = 8  # pictures of a resting place
_NEAR_PX = 0.25  # of a resting place's median, pictures that its mean is of
_PASSED = 2.0  # times a cell's median misfit: something else is there
_SELDOM, _OFTEN = 0.02, 0.5  # shares of pictures between which a cell is passed
INTRA, FORWARD, BETWEEN = 1, 2, 3  # kinds of coded pictures, as FFmpeg numbers I, P and B


@dataclass(frozen=True)
class GreyPicture:
    """One picture of a fixed camera."""

    grey: np.ndarray  # [H, W] uint8, or float32 of that range
    time_s: float
    kind: int = INTRA


@dataclass(frozen=True)
class CellSeries:
    """Shifts, gains and misfits of C cells in F pictures."""

    times_s: np.ndarray  # [F]
    kinds: np.ndarray  # [F] INTRA, FORWARD or BETWEEN
    shift: np.ndarray  # [F, C, 2] pixels right and down; NaN where a cell is dark
    gain: np.ndarray  # [F, C]
    misfit: np.ndarray  # [F, C] mean square of what shift, gain and offset leave, grey levels²
    change: np.ndarray  # [F, C] the same of gain and offset alone
    covariance: np.ndarray  # [C, 2, 2] px² of a shift for a misfit of 1
    place: np.ndarray  # [F] which resting place of the camera
    grid: Grid
    size: tuple[int, int]  # width and height, pixels
    first: np.ndarray  # [H, W] uint8: the first picture
    row_means: np.ndarray  # [F, H] grey levels
    matched: np.ndarray  # [C] bool: found by whole pixels first (`matching.py`)

    def of_pictures(self, which: np.ndarray, times_s: np.ndarray) -> "CellSeries":
        """Return only those pictures, with these times."""
        return replace(
            self,
            times_s=times_s,
            **{
                name: getattr(self, name)[which]
                for name in ("kinds", "shift", "gain", "misfit", "change", "place", "row_means")
            },
        )


def baseline_in(series: CellSeries) -> BaselineMisfit:
    """Return the baseline misfit of its cells."""
    return baseline_of(series.misfit, series.covariance, series.grid, series.kinds == INTRA)


def read_cells(
    pictures: Iterable[GreyPicture], where: str = "the recording", small_cells: bool = False
) -> CellSeries:
    """All cells' series. Raises CaptureError where there are fewer than 24 pictures, or of several sizes."""
    reader = _TemplateReader(small_cells)
    times: list[float] = []
    kinds: list[int] = []
    row_means: list[np.ndarray] = []
    block, filled = np.empty((0, 0, 0)), 0  # a buffer for the pictures that are read together
    shape: tuple[int, ...] | None = None
    first: np.ndarray | None = None
    for picture in read_ahead(pictures):
        if shape is not None and picture.grey.shape != shape:
            raise CaptureError(
                f"{where}: picture {len(times)} has {_size(picture.grey.shape)} pixels, the first {_size(shape)}"
            )
        if shape is None:
            check_picture_size(where, *picture.grey.shape[::-1])
        shape = picture.grey.shape
        first = np.array(picture.grey).astype(np.uint8) if first is None else first
        times.append(picture.time_s)
        kinds.append(picture.kind)
        row_means.append(picture.grey.mean(1, dtype=np.float32))
        if not filled:
            few = max(FEWEST, min(MEAN_OF, _FIRST_BYTES // picture.grey.size))
            n = _at_once(picture.grey.size) if reader.templates else few
            block = block if len(block) == n else np.empty((n, *shape), picture.grey.dtype)
        block[filled] = picture.grey
        filled += 1
        if filled == len(block):
            reader.add(block, np.array(kinds))
            filled = 0
    if len(times) < FEWEST or shape is None or first is None:
        raise CaptureError(
            f"{where}: holds {len(times)} pictures; at least {FEWEST} are needed to look for vibrations"
        )
    if filled:
        reader.add(block[:filled], np.array(kinds))
    shift, gain, misfit, change = reader.solved()
    covariance, grid = reader.templates[0].covariance, reader.grid
    is_matched = np.zeros(len(grid), bool)
    baseline = baseline_of(misfit, covariance, grid, np.array(kinds) == INTRA)
    mean_change = change.mean(0)
    for patch in reader.patches:
        found = matched(patch, baseline, mean_change)
        if found is not None:
            cells = found.cells
            shift[:, cells], gain[:, cells], misfit[:, cells] = found.shift, found.gain, found.misfit
            covariance[cells], is_matched[cells] = found.covariance, True
    return CellSeries(
        *(np.array(times) - times[0], np.array(kinds), shift.astype(float), gain.astype(float)),
        *(misfit.astype(float), change.astype(float), covariance.astype(float), np.array(reader.place)),
        *(grid, (shape[1], shape[0])),
        *(first, np.stack(row_means), is_matched),
    )


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]}×{shape[0]}"


class _TemplateReader:
    """Templates, and the products of all pictures so far."""

    def __init__(self, small_cells: bool) -> None:
        self._small = small_cells
        self.templates: list[Template] = []
        self.place: list[int] = []
        self.patches: list[Patch] = []  # of cells that may move by more than a pixel
        self._products: list[tuple[np.ndarray, np.ndarray]] = []
        self.grid = Grid(0, 0, 1)

    def add(self, pictures: np.ndarray, kinds: np.ndarray) -> None:
        """kinds: of all pictures so far."""
        if self.templates:
            self._keep(pictures, self.templates[-1], len(self.templates) - 1)
        else:
            self._begin(pictures)
            self.patches = patches_of(self._far(kinds == INTRA), self.grid, pictures.shape[1:])
        for patch in self.patches:
            patch.keep(pictures)
        if sum(patch.size_bytes for patch in self.patches) > _MATCHED_BYTES:
            self.patches = []

    def _far(self, alone: np.ndarray) -> np.ndarray:
        """Return [C] bool: cells that no small shift explains, or whose shift is far from the whole picture's."""
        shift, _, misfit, _ = self.solved()
        covariance = self.templates[0].covariance
        deviation = np.linalg.norm(np.nan_to_num(shift - whole_shift(shift, covariance)[:, None]), axis=2)
        baseline = baseline_of(misfit, covariance, self.grid, alone)
        noise = np.sqrt(np.einsum("cii->c", covariance) * baseline.typical)
        return baseline.stand_out() | (
            np.percentile(deviation, 95, axis=0) > np.maximum(_FAR_PX, _CLEAR * noise)
        )

    def solved(self) -> tuple[np.ndarray, ...]:
        """Shifts [F, C, 2], gains, misfits and changes [F, C]."""
        parts, place = [], np.array(self.place)
        products = np.concatenate([p for p, _ in self._products], 1)
        energy = np.concatenate([e for _, e in self._products], 1)
        for k, template in enumerate(self.templates):
            parts.append(template.solved(products[:, place == k], energy[:, place == k]))
        shift, *others = (np.concatenate(values, 1) for values in zip(*parts, strict=True))
        return shift.transpose(1, 0, 2), *(values.T for values in others)

    def _begin(self, pictures: np.ndarray) -> None:
        height, width = pictures.shape[1:]
        cell = CELL if self._small or height * width < SMALL else LARGE_CELL
        grid = self.grid = Grid.of(width, height, min(cell, height, width))
        template = Template(pictures.mean(0, dtype=np.float32), grid)
        products = _products_of(template, pictures)
        shift, _, misfit, _ = template.solved(*products)
        whole = whole_shift(shift.transpose(1, 0, 2), template.covariance)
        stops = [0, *knocks(whole), len(pictures)]
        if len(stops) > 2:
            for k, (first, stop) in enumerate(pairwise(stops)):
                near = np.linalg.norm(whole[first:stop] - np.median(whole[first:stop], 0), axis=1) < _NEAR_PX
                part = pictures[first:stop]
                resting = part[near] if near.sum() >= _SHORTEST else part
                self.templates.append(Template(resting.mean(0, dtype=np.float32), grid))
                self._keep(part, self.templates[-1], k)
            return
        unlike = misfit > _PASSED * np.median(misfit, 1, keepdims=True)
        passed = (unlike.mean(1) > _SELDOM) & (unlike.mean(1) < _OFTEN)
        if passed.any():
            template = Template(_mean_without(pictures, template.mean, unlike, passed, grid), grid)
            products = _products_of(template, pictures)
        self.templates.append(template)
        self._products.append(products)
        self.place += [0] * len(pictures)

    def _keep(self, pictures: np.ndarray, template: Template, place: int) -> None:
        self._products.append(_products_of(template, pictures))
        self.place += [place] * len(pictures)


def _products_of(template: Template, pictures: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    step = _at_once(pictures[0].size)
    parts = [template.products(pictures[k : k + step]) for k in range(0, len(pictures), step)]
    return np.concatenate([p for p, _ in parts], 1), np.concatenate([e for _, e in parts], 1)


def _at_once(pixels: int) -> int:
    return max(1, min(_AT_ONCE, _PIXELS_AT_ONCE // pixels))


def _mean_without(
    pictures: np.ndarray, mean: np.ndarray, unlike: np.ndarray, passed: np.ndarray, grid: Grid
) -> np.ndarray:
    """Return the mean picture; cells that something passes use only the frames without it."""
    mean, size = mean.copy(), grid.size
    for cell in np.flatnonzero(passed):
        row, column = (int(k) * size for k in divmod(cell, grid.columns))
        tile = pictures[~unlike[cell], row : row + size, column : column + size]
        mean[row : row + size, column : column + size] = tile.mean(0, dtype=np.float32)
    return mean


def whole_shift(shift: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return [F, 2]: the median over area of shifts [F, C, 2], of cells with texture."""
    spread = np.einsum("cii->ci", covariance).max(1)
    usable = np.isfinite(spread) & np.isfinite(shift).all((0, 2))
    if not usable.any():
        return np.zeros((len(shift), 2))
    usable &= spread < 9 * np.median(spread[usable])
    return np.asarray(np.median(shift[:, usable], 1))


def knocks(whole: np.ndarray) -> list[int]:
    """Return the frames at which the complete picture's shift [F, 2] steps permanently by more than half a pixel."""
    found: list[int] = []

    def search(first: int, stop: int) -> None:
        if stop - first < 2 * _SHORTEST:
            return
        x, n = whole[first:stop], np.arange(1, stop - first)[:, None]
        before, total = np.cumsum(x, 0)[:-1], x.sum(0)
        explained = (before**2 / n + (total - before) ** 2 / (stop - first - n)).sum(1)
        at = first + _SHORTEST + int(np.argmax(explained[_SHORTEST - 1 : len(x) - _SHORTEST]))
        if np.linalg.norm(np.median(whole[at:stop], 0) - np.median(whole[first:at], 0)) > _KNOCK_PX:
            found.append(at)
            search(first, at)
            search(at, stop)

    search(0, len(whole))
    return sorted(found)
