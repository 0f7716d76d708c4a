"""The measuring instrument: motion of regions in the pictures of one fixed camera, with its uncertainty.

Each region is measured as a rigid body against its mean picture (`template.py`), separately in two halves of its
pixels, whose difference gives the noise. Motion beyond a third of a pixel is iterated (`registration.py`). With a
rolling shutter, rows are brought to the time at which the region as a whole is read.
"""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.ndimage import binary_dilation

from tg4mm.capture.tracking.registration import EDGE, ROUNDS, TAPS, Box, offsets_within, refined, spread
from tg4mm.capture.tracking.row_times import bands_of
from tg4mm.capture.tracking.template import Solved, Template, Turn
from tg4mm.core.even_clock import later
from tg4mm.core.memory import mapped_zeros
from tg4mm.core.pictures.decode import THREADS

LARGE_PX = 1 / 3  # motion of most frames from which it is iterated
UNEXPLAINED = 0.12  # share of the change that a small motion leaves, from which whole pixels are sought
REACHES = 8, 24  # pixels that whole offsets are sought within
_MARGIN = EDGE + TAPS + REACHES[-1]  # pixels around a region
_MOST = 150_000_000  # pixels of all frames of a region that is iterated: a larger one bends
_LEVELS = 256  # steps of a grey level that pictures are kept in
_AT_ONCE = 1 << 24  # values
_SQUARES = 3.0  # of a region's radius, over the side of the squares that its halves are cut into
_SIDE = 2, 16  # pixels of such a square, at least and at most
_EXTREME = 3  # frames that change most, at least, that are judged by
_QUIET = 10.0  # per cent of the frames that show noise alone
# times the noise, and grey levels²: changes beyond both are no noise of a codec
_CLEAR, _CLEAR_LEVELS2 = 4.0, 16.0
_LEAST_ROOT = 1e-3
_MOSTLY = 0.5  # share of a frame's change that no motion explains, from which it shows something else
_AROUND = 2  # frames before and after that it may show a little of it
_MOST_HIDDEN = 0.5  # of the frames
_LEFT_BEHIND = 2.0  # times the most that motion explains
_HALVED = (
    0.5  # of what a small motion leaves: if a large one leaves less, it is large (a codec leaves the rest)
)
Frames = Callable[[Box], np.ndarray]  # some frames' grey levels [f, h, w], 0 to 255, in a box


@dataclass(frozen=True)
class TrackedRegion:
    """Two halves of a region's pixels, in a chessboard of squares, within a box of the picture."""

    box: Box  # of the picture, with what moves into the region
    inner: Box  # of the box: the region, with what its slopes need
    index: np.ndarray  # [2, P] pixels of the inner box, rows first; the shorter half is filled up
    root: np.ndarray  # [2, P] square root of each pixel's weight; 0: filled up
    turn: Turn  # about its centre, in the inner box
    centre: tuple[float, float]  # pixels right and down from the picture's corner

    @staticmethod
    def of(mask: np.ndarray) -> "TrackedRegion":
        """Make a region of weights [H, W], 0 to 1, that are not all 0."""
        rows, columns = (np.flatnonzero(mask.any(axis)) for axis in (1, 0))
        ends = [(int(k[0]), int(k[-1]) + 1, n) for k, n in zip((rows, columns), mask.shape, strict=True)]
        outer, (down, right) = (
            [slice(max(first - m, 0), min(last + m, n)) for first, last, n in ends] for m in (_MARGIN, EDGE)
        )
        inner = [
            slice(part.start - wide.start, part.stop - wide.start)
            for part, wide in zip((down, right), outer, strict=True)
        ]
        weight = mask[down, right].astype(np.float64)
        y, x = np.mgrid[: weight.shape[0], : weight.shape[1]] + 0.5
        centre = float((weight * x).sum() / weight.sum()), float((weight * y).sum() / weight.sum())
        radius = max(
            float(np.sqrt((weight * ((x - centre[0]) ** 2 + (y - centre[1]) ** 2)).sum() / weight.sum())), 0.5
        )
        side = int(np.clip(radius / _SQUARES, *_SIDE))
        halves = ((x - centre[0]) // side + (y - centre[1]) // side) % 2
        some = [np.flatnonzero((weight > _LEAST_ROOT**2) & (halves == half)) for half in (0, 1)]
        index, root = np.zeros((2, max(map(len, some))), int), np.zeros((2, max(map(len, some))), np.float32)
        for half, pixels in enumerate(some):
            index[half, : len(pixels)], root[half, : len(pixels)] = pixels, np.sqrt(weight.ravel()[pixels])
        at = centre[0] + right.start, centre[1] + down.start
        return TrackedRegion(
            (outer[0], outer[1]), (inner[0], inner[1]), index, root, Turn(centre, radius), at
        )

    def __len__(self) -> int:
        return len(self.index)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the box."""
        return self.box[0].stop - self.box[0].start, self.box[1].stop - self.box[1].start

    @property
    def top(self) -> int:
        """Row of the picture that is the first of the inner box."""
        return self.box[0].start + self.inner[0].start

    @property
    def inside(self) -> np.ndarray:
        """Return [h, w] 1 in the box where the region is, else 0."""
        out = np.zeros(self.shape, np.float32)
        part = np.zeros((self.inner[0].stop - self.inner[0].start, self.inner[1].stop - self.inner[1].start))
        part.ravel()[self.index[self.root > 0]] = 1
        out[self.inner] = part
        return out

    def cut(self, pictures: np.ndarray) -> np.ndarray:
        """Return [2, F, P] float32, weighted, of pictures [F, h, w] of the inner box."""
        flat = pictures.reshape(len(pictures), -1)
        return np.stack(
            [
                flat[:, pixels].astype(np.float32) * root
                for pixels, root in zip(self.index, self.root, strict=True)
            ]
        )


@dataclass(frozen=True)
class RowClock:
    """Times of a region's rows, for a camera that reads them one after another."""

    region: TrackedRegion
    times_s: np.ndarray  # [F] of the frames' middle rows
    delays_s: np.ndarray  # [h] of the inner box's rows after that
    bands: list[tuple[float, list[slice]]]  # delay, and pixels of each half
    delay_s: float  # of the region as a whole

    @staticmethod
    def of(
        region: TrackedRegion, mean: np.ndarray, times_s: np.ndarray, readout_s: float, height: int
    ) -> "RowClock":
        """mean [h, w] of the inner box; height: of the picture."""
        rows, bands, known = region.index // mean.shape[1], [], []
        slope = (np.array(np.gradient(mean)) ** 2).sum(0).ravel()
        weight = slope[region.index] * region.root**2
        delays = np.zeros(len(mean))
        for band in bands_of(readout_s, height):
            first, last = (edge - region.top for edge in (band.rows.start, band.rows.stop))
            delays[max(first, 0) : max(last, 0)] = band.delay_s
            counts = [int((root > 0).sum()) for root in region.root]
            ends = [
                slice(*np.searchsorted(numbers[:n], [first, last]))
                for numbers, n in zip(rows, counts, strict=True)
            ]
            if any(span.stop > span.start for span in ends):
                bands.append((band.delay_s, ends))
                known.append(sum(float(weight[k, span].sum()) for k, span in enumerate(ends)))
        weights = np.maximum(known, 1e-12 * max(max(known), 1e-30))
        whole = float(np.average([delay for delay, _ in bands], weights=weights))
        return RowClock(region, times_s, delays, bands, whole)

    def by_row(self, shift: np.ndarray) -> np.ndarray:
        """Return [F, h, 2] from [F, 2], at the time of the region as a whole."""
        unique, which = np.unique(self.delays_s, return_inverse=True)
        each = [later(self.times_s, shift.T, delay - self.delay_s).T for delay in unique]
        return np.stack(each, 1)[:, which]

    def products(self, template: Template, pictures: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return `Template.products` of all F pictures."""
        return self.brought(*self.parts_of(template, pictures))

    def parts_of(self, template: Template, pictures: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return [2, B, f, 8] products of each band of some pictures, and energies [2, f]."""
        difference = template.difference(pictures)
        parts = [
            template.banded_products(part, half, [ends[half] for _, ends in self.bands])
            for half, part in enumerate(difference)
        ]
        return np.stack(parts), np.einsum("cfp,cfp->cf", difference, difference)

    def brought(self, parts: np.ndarray, energy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return [2, F, 8] products at the time of the region, and the energies."""
        total = np.zeros((len(parts), *parts.shape[2:]))
        for b, (delay, _) in enumerate(self.bands):
            part = np.moveaxis(parts[:, b], 1, -1)  # [2, 8, F]
            moved = later(self.times_s, part.reshape(-1, part.shape[-1]), self.delay_s - delay)
            total += np.moveaxis(moved.reshape(part.shape), -1, 1)
        return total, energy


@dataclass(frozen=True)
class RegionMotion:
    """Measured motion of one region in F frames: right, down and counter-clockwise, the last at `radius_px`."""

    centre_px: tuple[float, float]  # right and down
    radius_px: float  # rms distance of its pixels from the centre
    delay_s: float  # of its own rows after the middle ones
    shift: np.ndarray  # [2, F, 3] pixels, of each half of its pixels
    normals: np.ndarray  # [2, 3, 3] information of each half, grey levels² / px²
    noise: np.ndarray  # [2, 3, 3] covariance of `normals` @ `shift` for pixels with noise of variance 1
    misfit: np.ndarray  # [F] mean square of what motion, gain and offset leave, grey levels²
    change: np.ndarray  # [F] the same of gain and offset alone, about the pictures' mean
    hidden: np.ndarray  # [F] bool: something else is seen for a while; the motion is interpolated there
    is_iterated: bool  # its motion was too large for one step

    @property
    def whole(self) -> np.ndarray:
        """Return [F, 2] pixels right and down of both halves together."""
        total = self.normals.sum(0)
        total = total + (1e-9 * np.trace(total) + 1e-12) * np.eye(3)
        weighted = np.einsum("cij,cfj->fi", self.normals, self.shift)
        return np.asarray(np.linalg.solve(total, weighted.T).T[:, :2])

    @property
    def other_share(self) -> float:
        """Share, 0 to 1, of the largest changes that are no motion of the region, such as an occluder or light.

        0 where nothing changes by more than noise.
        """
        return _other_share(self.misfit, self.change)


def _other_share(misfit: np.ndarray, change: np.ndarray) -> float:
    noise = float(np.percentile(misfit, _QUIET))
    large = np.flatnonzero(_changed(misfit, change))
    largest = large[np.argsort(-change[large])][: max(_EXTREME, len(change) // 10)]
    if len(largest) < _EXTREME:
        return 0.0
    return float(np.median(np.clip((misfit[largest] - noise) / (change[largest] - noise), 0, 1)))


def _changed(misfit: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Return [F] bool: frames that change by more than noise."""
    return np.asarray(change > _CLEAR * float(np.percentile(misfit, _QUIET)) + _CLEAR_LEVELS2)


def _hidden(misfit: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Return [F] bool: frames in which an object occludes the region, with some around them; none if most would be.

    Motion leaves more than noise of blocks that a codec moves late or not at all: not much more than what it explains
    elsewhere, and about as much in other frames that change.
    """
    noise, changed = float(np.percentile(misfit, _QUIET)), _changed(misfit, change)
    usual = float(np.median(misfit[changed])) if changed.any() else 0.0
    least = min(_LEFT_BEHIND * float((change - misfit).max()), _CLEAR * usual)
    unlike = misfit > np.maximum(max(_CLEAR * noise + _CLEAR_LEVELS2, least), _MOSTLY * change)
    out = binary_dilation(unlike, iterations=_AROUND) if unlike.any() else unlike
    return out if out.mean() < _MOST_HIDDEN else np.zeros(len(out), bool)


def region_motions(
    pictures: Iterable[Frames],
    masks: Sequence[np.ndarray],
    times_s: np.ndarray,
    readout_s: float = 0.0,
    step: Callable[[], None] = lambda: None,
) -> list[RegionMotion]:
    """Measure the motion of regions in one pass over the pictures of a fixed camera.

    Args:
        pictures: a few frames at a time, all F of them in order.
        masks: weights [H, W] of each region's pixels, 0 to 1.
        times_s: [F] seconds of the frames' middle rows.
        readout_s: seconds from a picture's first row to its last; 0: all rows at once.
        step: is called after each region.

    Returns:
        The motion of each region, in the order of the masks.
    """
    regions = [TrackedRegion.of(mask) for mask in masks]
    kept = [mapped_zeros((len(times_s), *region.shape), np.uint16) for region in regions]
    first = 0
    with ThreadPoolExecutor(THREADS) as pool:
        for some in pictures:
            for region, cut in zip(regions, kept, strict=True):
                grey = some(region.box)
                list(pool.map(partial(_keep, cut[first:]), range(len(grey)), grey))
            first += len(grey)
    out = []
    for region, cut in zip(regions, kept, strict=True):
        out.append(_measured(region, cut, times_s, readout_s, masks[0].shape[0]))
        step()
    return out


def _keep(kept: np.ndarray, k: int, grey: np.ndarray) -> None:
    kept[k] = np.rint(np.clip(grey, 0, 255) * _LEVELS)


def _measured(
    region: TrackedRegion, kept: np.ndarray, times_s: np.ndarray, readout_s: float, height: int
) -> RegionMotion:
    first = _estimated(region, kept, times_s, readout_s, height)
    if not first.hidden.any():
        return first
    seen = np.flatnonzero(~first.hidden)
    motion = _estimated(region, kept[seen], times_s[seen], readout_s, height)
    shift = np.stack(
        [[np.interp(times_s, times_s[seen], y) for y in half.T] for half in motion.shift]
    ).transpose(0, 2, 1)
    misfit, change = first.misfit.copy(), first.change.copy()
    misfit[seen], change[seen] = motion.misfit, motion.change
    return replace(motion, shift=shift, misfit=misfit, change=change, hidden=first.hidden)


def _estimated(
    region: TrackedRegion, kept: np.ndarray, times_s: np.ndarray, readout_s: float, height: int
) -> RegionMotion:
    mean = (kept[:, *region.inner].mean(0, dtype=np.float64) / _LEVELS).astype(np.float32)
    clock = RowClock.of(region, mean, times_s, readout_s, height) if readout_s else None
    template = Template(mean, region, region.turn)
    of_some = template.products if clock is None else partial(clock.parts_of, template)
    with ThreadPoolExecutor(THREADS) as pool:
        parts = list(pool.map(lambda some: of_some(_inner(kept[some], region)), _chunks(kept)))
    products = np.concatenate([p for p, _ in parts], -2), np.concatenate([e for _, e in parts], 1)
    solved = template.solved(*(products if clock is None else clock.brought(*products)))
    weights = np.array([float((root > 0).sum()) for root in region.root])
    change = np.average(solved.change, axis=0, weights=weights)
    again = _iterated(region, kept, template, solved, clock) if kept.size <= _MOST else None
    solved, template = again or (solved, template)
    normals, noise = template.motion_equations()
    shift = np.nan_to_num(solved.shift)
    misfit = np.average(solved.misfit, axis=0, weights=weights)
    return RegionMotion(
        region.centre, region.turn.radius, 0.0 if clock is None else clock.delay_s,
        shift, normals, noise, misfit, change, _hidden(misfit, change), again is not None,
    )  # fmt: skip


def _iterated(
    region: TrackedRegion, kept: np.ndarray, template: Template, solved: Solved, clock: RowClock | None
) -> tuple[Solved, Template] | None:
    """Return the motion by registered frames if it is large and they explain more, else None."""
    whole = template.together(solved.shift)
    misfit, change = solved.misfit.mean(0), solved.change.mean(0)
    other = _other_share(misfit, change)
    unexplained = other > UNEXPLAINED
    if spread(whole) <= LARGE_PX and not unexplained:
        return None
    pictures = kept.astype(np.float32) / _LEVELS
    starts = [(whole, True)]  # and whether a start is near, so that it matches no wrong place
    if unexplained or spread(whole) > 2 * LARGE_PX:
        offsets = offsets_within(pictures, region.inside, REACHES)
        if offsets is not None:
            starts.append((offsets.astype(float), not unexplained))
    moving = _changed(misfit, change)  # early frames of what rings down: the others show noise alone
    judged = moving if moving.sum() >= _EXTREME else np.ones(len(misfit), bool)
    best, least = None, float(np.median(misfit[judged]))
    for start, is_near in starts:
        again, fresh, _ = refined(pictures, region, start, region.inner, ROUNDS, region.turn, clock)
        left = again.misfit.mean(0)
        explains = is_near or _other_share(left, change) < max(UNEXPLAINED, _HALVED * other)
        if explains and float(np.median(left[judged])) < least:
            best, least = (again, fresh), float(np.median(left[judged]))
    if best is None:
        return None
    moved = best[0].shift
    moved[..., :2] -= best[1].together(moved).mean(0)  # about the mean, as small motion is
    return best


def _chunks(kept: np.ndarray) -> list[slice]:
    """Return a few frames at a time."""
    step = max(1, _AT_ONCE // kept[0].size)
    return [slice(first, first + step) for first in range(0, len(kept), step)]


def _inner(kept: np.ndarray, region: TrackedRegion) -> np.ndarray:
    """Return grey levels of the inner box."""
    return kept[:, *region.inner].astype(np.float32) / _LEVELS
