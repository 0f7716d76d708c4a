"""Global shifts of the picture over a recording: whether the camera was fixed, and when it was knocked.

The shift of a frame from the first one is found by phase correlation (Kuglin & Hines 1975) on a reduced grey picture
and refined by Lucas–Kanade (1981) on blocks, whose median is used: moving objects are a minority. Where they are not,
as with a bridge before the sky, the blocks show it: a knocked camera moves nearly all of them.

A frozen picture, or a recording that hardly changes, is distinguished from effects of the codec. A sensor's noise and a
scene's motion change blocks of the picture in nearly every frame. For a frozen picture, a codec changes blocks at key
frames, refines them after these, and alternates between its kinds of frames, back to earlier pictures. So a block is
new if it differs from each of the last RECENT frames. Flickering light changes a still picture from frame to frame and
returns too. A picture whose brightness changes is not frozen; and a frozen run is only found in a recording in which
more than the light changes otherwise.
"""

from collections import deque
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter

LONGEST = 400  # pixels of the longer side of the reduced picture
BLOCK = 32  # pixels of it, or a quarter of its shorter side
FIXED_PX = 2.0  # median shift of a camera that stays put, at most; or
FIXED_SHARE = 0.002  # this part of the longer side
ALIKE = 0.5  # correlation with the first frame below which a shift means nothing
KNOCK_PX = 0.5  # a step of the whole picture that counts as a knock
KNOCK_SCATTER = 6.0  # times the scatter of the frames before and after it
TOGETHER = 0.75  # share of the blocks with something to see that go along with a knock
KNOCK_WINDOW_S = 0.5  # before and after a knock; at least KNOCK_FRAMES
KNOCK_FRAMES = 5
MOST_KNOCKS = 5  # of a camera that stays put; one that steps more often is carried
BUMP_PX = 2.0  # that fewer than KNOCK_FRAMES frames lie apart from those around them
BUMP_SCATTER = 8.0  # times the scatter of those
MOST_PARTS = 6  # scenes that a recording is cut into
_UNLIKE = (float("nan"),) * 3
STAYING = 0.8  # share of the frames of a fixed camera

RECENT = 4  # frames; more than B-frames stand between others in most videos
NOVELTY_BLOCK = 8  # pixels of the thinned picture
CHANGED = 0.1  # mean absolute difference of a block, grey levels of 255, above which it has changed
SILENT = 0.003  # share of new blocks in a quarter of the frames or more, at most, of a frozen recording
QUIET = 0.05  # the same in its median frame
BUSY = 0.5  # share of the frames in which a block is new that shows something that moves
ALIVE = 0.2  # share of new blocks in a fifth of the frames of a recording whose still frames stand out,
STILL = 0.02  # those with fewer new blocks than this
NOISE = 1.3  # grey levels between successive key frames that are a sensor's noise, where it is
EVEN = 0.75  # as large between all of them
FEWEST_KEYS = 3  # changes between key frames, after the first, that distinguish noise from one picture
LIVELY = 0.5  # share of new blocks in each of
LIVELY_RUN = 10  # successive frames of a recording that is not frozen all along
SHORTEST = 5  # frames of a frozen run
LIT = 0.5  # grey levels that the picture's mean goes up and down by, where the light changes
RELIT = 0.6  # mean change of a block beyond gain and offset, grey levels, that is more than light, rounded to 8 bits
GAP = 2  # frames between two runs that make no end of them: a key frame and what follows it


def reduced(grey: np.ndarray) -> tuple[np.ndarray, int]:
    """The picture [H, W] averaged over k × k pixels, float32, and k."""
    k = max(1, -(-max(grey.shape) // LONGEST))
    height, width = (n // k * k for n in grey.shape)
    total = np.zeros((height // k, width // k), np.float32)
    for row in range(k):
        for column in range(k):
            total += grey[row:height:k, column:width:k]
    return total / np.float32(k * k), k


class ShiftMeter:
    """Shifts of pictures from the first one."""

    def __init__(self, first: np.ndarray) -> None:
        """first [h, w] float32, grey, reduced."""
        window = np.outer(np.hanning(first.shape[0]), np.hanning(first.shape[1]))
        self._window = window.astype(np.float32)
        self._spectrum = np.conj(np.fft.rfft2((first - first.mean()) * self._window))
        self._block = min(BLOCK, max(1, min(first.shape) // 4))
        self._smooth = gaussian_filter(first, 1.0)
        self._gradient = np.gradient(self._smooth)

    def shift(self, grey: np.ndarray) -> tuple[float, float]:
        """x and y, pixels of the reduced picture; NaN where the pictures have nothing in common."""
        return self.together(grey)[:2]

    def together(self, grey: np.ndarray) -> tuple[float, float, float]:
        """x and y, pixels of the reduced picture, and the share of its blocks that the shift makes more alike.

        NaN where the pictures have nothing in common.
        """
        cross = np.fft.rfft2((grey - grey.mean()) * self._window) * self._spectrum
        peak = np.fft.irfft2(cross / np.maximum(np.abs(cross), 1e-9), s=grey.shape)
        rows, columns = grey.shape
        y, x = divmod(int(peak.argmax()), columns)
        y, x = y - rows * (y > rows // 2), x - columns * (x > columns // 2)
        dx, dy, together, alike = self._refined(gaussian_filter(grey, 1.0), x, y)
        return (x + dx, y + dy, together) if alike >= ALIKE else _UNLIKE

    def _refined(self, smooth: np.ndarray, x: int, y: int) -> tuple[float, float, float, float]:
        """Return the shift after (x, y) whole pixels, the share of blocks, and the correlation of the overlap."""
        rows, columns = smooth.shape
        if min(rows - abs(y), columns - abs(x)) < 2 * self._block:
            return 0.0, 0.0, 0.0, 0.0
        here = (slice(max(0, -y), rows - max(0, y)), slice(max(0, -x), columns - max(0, x)))
        there = (slice(max(0, y), rows + min(0, y)), slice(max(0, x), columns + min(0, x)))
        first, other = self._smooth[here], smooth[there]
        alike = (
            float(np.corrcoef(first.ravel(), other.ravel())[0, 1]) if first.std() * other.std() > 0 else 0.0
        )
        gy, gx = (g[here] for g in self._gradient)
        # A frame brighter or darker as a whole must not look like one that has moved.
        change, unmoved = (_change(first, seen) for seen in (other, smooth[here]))
        xx, yy, xy, bx, by = (
            _blocks(a, self._block) for a in (gx * gx, gy * gy, gx * gy, gx * change, gy * change)
        )
        determinant, trace = xx * yy - xy * xy, xx + yy
        weakest = trace / 2 - np.sqrt(np.maximum(trace**2 / 4 - determinant, 0))
        good = weakest > 0.2 * np.median(weakest) + 1e-6
        if not good.any():
            return 0.0, 0.0, 0.0, alike
        dx = -(yy * bx - xy * by)[good] / determinant[good]
        dy = -(xx * by - xy * bx)[good] / determinant[good]
        own_x, own_y = float(np.median(dx)), float(np.median(dy))
        moved = _blocks((change + own_x * gx + own_y * gy) ** 2, self._block)
        together = float((moved < _blocks(unmoved**2, self._block))[good].mean())
        return own_x, own_y, together, alike


def _change(first: np.ndarray, other: np.ndarray) -> np.ndarray:
    """other - first, less brightness and contrast of the whole."""
    scaled = other * (first.std() / max(float(other.std()), 1e-6))
    return np.asarray((scaled - scaled.mean()) - (first - first.mean()))


def _blocks(values: np.ndarray, size: int) -> np.ndarray:
    """Return sums over size × size pixels; incomplete squares at the edges are dropped."""
    rows, columns = (n // size for n in values.shape)
    return values[: rows * size, : columns * size].reshape(rows, size, columns, size).sum(axis=(1, 3))


class PartMeter:
    """Shifts within each part: a picture unlike the first one of its part and unlike the one before begins another."""

    def __init__(self) -> None:
        self._meters: list[ShiftMeter] = []
        self._part = 0
        self._before: np.ndarray | None = None

    def add(self, grey: np.ndarray) -> tuple[int, float, float, float]:
        """The part of the next picture [h, w], its shift from its first one, and the share of blocks that show it.

        NaN where it is unlike that.
        """
        if not self._meters:
            self._meters.append(ShiftMeter(grey))
        before, self._before = self._before, grey
        shift = self._meters[self._part].together(grey)
        if np.isnan(shift[0]) and before is not None and np.isnan(ShiftMeter(before).shift(grey)[0]):
            shift = self._elsewhere(grey)
        return self._part, *shift

    def _elsewhere(self, grey: np.ndarray) -> tuple[float, float, float]:
        """Go to the part that this picture is of, a new one where it is like none."""
        for part, meter in enumerate(self._meters):
            shift = meter.together(grey)
            if not np.isnan(shift[0]):
                self._part = part
                return shift
        if len(self._meters) == MOST_PARTS:
            return _UNLIKE
        self._part = len(self._meters)
        self._meters.append(ShiftMeter(grey))
        return 0.0, 0.0, 0.0


@dataclass(frozen=True)
class Knock:
    """A moment at which a camera that stays put before and after moved."""

    frame: int  # the first one after it
    time_s: float  # of that frame
    shift_px: float  # of the whole picture


def stays(shifts_px: np.ndarray, longer_side: int) -> bool:
    """Return whether a camera with these shifts [T, 2] (pixels; NaN: no match) was fixed."""
    if np.isnan(shifts_px).any(axis=1).mean() > 0.5:
        return False
    middle = np.nanmedian(shifts_px, axis=0)
    typical = float(np.nanmedian(np.linalg.norm(shifts_px - middle, axis=1)))
    return typical <= max(FIXED_PX, FIXED_SHARE * longer_side)


def stays_in_parts(shifts_px: np.ndarray, stretches: list[tuple[int, int]], longer_side: int) -> bool:
    """Return whether a camera was fixed in nearly all of its segments (first frame, end), but was knocked."""
    steady = sum(
        stop - first
        for first, stop in stretches
        if stop - first >= min(KNOCK_FRAMES, len(shifts_px)) and stays(shifts_px[first:stop], longer_side)
    )
    return steady > 0 and steady >= STAYING * sum(stop - first for first, stop in stretches)


def find_knocks(
    shifts_px: np.ndarray, times_s: np.ndarray, together: np.ndarray | None = None
) -> list[Knock]:
    """Steps of the whole picture between frames that stand still before and after, in order; shifts [T, 2].

    together [T]: share of the blocks that a frame's shift makes more like the first frame; None: all. Not more than one
    above MOST_KNOCKS.
    """
    together = np.ones(len(shifts_px)) if together is None else together
    found: list[Knock] = []
    stretches = [(0, len(shifts_px))]
    while stretches and len(found) <= MOST_KNOCKS:
        first, stop = stretches.pop()
        knock = _largest_knock(shifts_px[first:stop], times_s[first:stop], together[first:stop])
        if knock is not None:
            at = first + knock.frame
            found.append(Knock(at, knock.time_s, knock.shift_px))
            stretches += [(first, at), (at, stop)]
    return sorted(found, key=lambda knock: knock.frame)


def find_bumps(shifts_px: np.ndarray, times_s: np.ndarray) -> list[tuple[int, int, float]]:
    """First frame, end and largest shift of each few frames that lie apart from all around them; shifts [T, 2]."""
    known = np.isfinite(shifts_px).all(axis=1)
    if known.sum() < 4 * KNOCK_FRAMES:
        return []
    at, window = np.flatnonzero(known), _window(times_s)
    away, scatter = np.zeros(len(shifts_px)), np.zeros(len(shifts_px))
    for i, t in enumerate(at):
        half = min(window, i, len(at) - 1 - i)  # as many on both sides, so that a drift leaves nothing
        around = shifts_px[at[i - half : i + half + 1]]
        distances = np.linalg.norm(around - np.median(around, axis=0), axis=1)
        away[t], scatter[t] = distances[half], np.median(distances)
    apart = away > np.maximum(BUMP_PX, BUMP_SCATTER * scatter)
    return [
        (first, stop, float(away[first:stop].max()))
        for first, stop in runs(apart)
        if first > 0 and stop < len(apart) and stop - first < KNOCK_FRAMES
    ]


def _window(times_s: np.ndarray) -> int:
    """Return the frames before and after a moment that are compared."""
    step_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 1.0
    return max(KNOCK_FRAMES, round(KNOCK_WINDOW_S / step_s))


def _largest_knock(shifts_px: np.ndarray, times_s: np.ndarray, together: np.ndarray) -> Knock | None:
    """The largest step of the whole picture between frames that stand still before and after; None without one."""
    shifts = np.where(np.isnan(shifts_px), 1e6, shifts_px)
    n = len(shifts)
    window = _window(times_s)
    worst: tuple[float, int] | None = None
    for t in range(KNOCK_FRAMES, n - KNOCK_FRAMES + 1):
        before, after = shifts[max(0, t - window) : t], shifts[t : t + window]
        places = np.median(before, axis=0), np.median(after, axis=0)
        step = float(np.linalg.norm(places[1] - places[0]))
        scatter = max(_scatter(before), _scatter(after))
        # which is further from the first frame
        is_after = np.linalg.norm(places[1]) > np.linalg.norm(places[0])
        share = np.median(together[t : t + window] if is_after else together[max(0, t - window) : t])
        is_knock = step > max(KNOCK_PX, KNOCK_SCATTER * scatter) and not share < TOGETHER
        if is_knock and (worst is None or step > worst[0]):
            worst = (step, t)
    if worst is None:
        return None
    step, t = worst
    # The medians of the windows step within half a window of it; the frames themselves show where.
    low, high = max(1, t - window), min(n - 1, t + window)
    jumps = np.linalg.norm(np.diff(shifts[low - 1 : high + 1], axis=0), axis=1)
    at = low + int(jumps.argmax())
    return Knock(at, float(times_s[at]), step)


def _scatter(shifts: np.ndarray) -> float:
    """Median distance from the median; a slow drift counts, so that it is no knock."""
    return float(np.median(np.linalg.norm(shifts - np.median(shifts, axis=0), axis=1)))


class NoveltyMeter:
    """Changes of each frame of a recording against the frames before it."""

    def __init__(self) -> None:
        self._recent: deque[np.ndarray] = deque(maxlen=RECENT)
        self._key: np.ndarray | None = None
        self._key_changes: list[float] = []
        self._news: list[float] = []  # share of new blocks, from the second frame that is not black on
        self._at: list[int] = []  # the frames that these are of
        self._relit: list[float] = []  # share of blocks that change by more than light, of the same frames
        self._blocks: list[np.ndarray] = []  # which blocks are new, packed bits, of the same frames
        self._brightness: list[float] = []  # means of all frames

    def add(self, grey: np.ndarray, is_key: bool) -> None:
        """Look at grey [h, w] uint8, thinned: every so-many-th pixel, as an average would take the noise away."""
        self._brightness.append(float(grey.mean()))
        height, width = (n // min(NOVELTY_BLOCK, n) * min(NOVELTY_BLOCK, n) for n in grey.shape)
        grey = grey[:height, :width].astype(np.int16)
        if self._recent:
            new = np.min([_block_changes(grey, before) for before in self._recent], axis=0) > CHANGED
            self._news.append(float(new.mean()))
            self._at.append(len(self._brightness) - 1)
            self._relit.append(float((_unlike(grey, self._recent[-1]) > RELIT).mean()))
            self._blocks.append(np.packbits(new))
        self._recent.append(grey)
        if is_key:
            if self._key is not None:
                self._key_changes.append(float(np.abs(grey - self._key).mean()))
            self._key = grey

    def add_black(self) -> None:
        """Count a frame that shows nothing."""
        self._brightness.append(0.0)

    @property
    def _is_lit(self) -> bool:
        seen = np.array(self._brightness)[self._at]
        return bool(np.ptp(np.quantile(seen, (0.05, 0.95))) > LIT)

    def hardly_changes(self, is_new: np.ndarray) -> bool:
        """Return whether all frames are one picture, or a still scene whose noise the codec removed.

        is_new [T] bool: frames that are no duplicates.
        """
        kept = is_new[self._at]
        news = np.array(self._news)[kept]
        if not len(news) or any(stop - first >= LIVELY_RUN for first, stop in runs(news >= LIVELY)):
            return False
        silent, median = np.quantile(news, (0.25, 0.5))
        busy = np.unpackbits(np.stack(self._blocks)[kept], axis=1).sum(0)
        busiest = busy.max() / len(news)
        return bool(silent <= SILENT and median < QUIET and busiest < BUSY and not self._keys_differ())

    def _keys_differ(self) -> bool:
        """Return whether key frames have noise that the frames between them lack. The first one is coarser."""
        changes = self._key_changes[1:]
        return len(changes) >= FEWEST_KEYS and min(changes) >= max(NOISE, EVEN * max(changes))

    def frozen_frames(self, is_new: np.ndarray) -> np.ndarray:
        """Return [T] bool: frames of runs of one picture in a recording that is alive otherwise.

        is_new [T] bool: frames that are no duplicates; the others are not counted.
        """
        length, counted = len(self._brightness), is_new[self._at]
        frozen = np.zeros(length, bool)
        alive = np.array(self._relit if self._is_lit else self._news)[counted]
        if not len(alive) or np.quantile(alive, 0.8) < ALIVE:
            return frozen
        kept = np.flatnonzero(is_new)
        still = np.zeros(length, bool)
        still[self._at] = np.array(self._news) < STILL
        for first, stop in runs(still[kept], GAP):
            if stop - first >= SHORTEST:
                frozen[kept[first:stop]] = True
        return frozen


def runs(flags: np.ndarray, gap: int = 0) -> list[tuple[int, int]]:
    """First frame and end (not included) of each run of true flags [T]; those at most `gap` frames apart are one."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    found = [(int(first), int(stop)) for first, stop in edges.reshape(-1, 2)]
    apart = [after[0] - before[1] > gap for before, after in pairwise(found)]
    starts = [run[0] for run, new in zip(found, [True, *apart], strict=False) if new]
    stops = [run[1] for run, new in zip(found, [*apart, True], strict=False) if new]
    return list(zip(starts, stops, strict=True))


def _in_blocks(grey: np.ndarray) -> np.ndarray:
    """Return [rows, columns, pixels] of each block."""
    rows, columns = (min(NOVELTY_BLOCK, n) for n in grey.shape)
    height, width = grey.shape
    blocks = grey.reshape(height // rows, rows, width // columns, columns)
    return blocks.transpose(0, 2, 1, 3).reshape(height // rows, width // columns, -1)


def _block_changes(grey: np.ndarray, other: np.ndarray) -> np.ndarray:
    return _in_blocks(np.abs(grey - other)).mean(axis=2)


def _unlike(grey: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the same, without the gain and the offset of each block."""
    a, b = (_in_blocks(g).astype(np.float32) for g in (grey, other))
    a, b = a - a.mean(2, keepdims=True), b - b.mean(2, keepdims=True)
    gain = (a * b).sum(2, keepdims=True) / np.maximum((b * b).sum(2, keepdims=True), 1e-6)
    return np.asarray(np.abs(a - gain * b).mean(2))
