"""Whether a recording shows one picture all along, or for a while, but for what its codec does to it.

A sensor's noise and a scene's motion change blocks of the picture in nearly every frame. A codec that is fed one
picture changes it at its key frames, refines it after them, and goes back and forth between its kinds of frames, to
pictures that were there a moment before. So a block counts as new where it is unlike each of the last RECENT frames.

Light that flickers changes a still picture from frame to frame and comes back too. A picture whose brightness changes
is not frozen; and a run of it is told only in a recording in which more than the light changes otherwise.
"""

from collections import deque
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np

# Pictures that a file shows more than once: 25 pictures a second stored as 30, as downloads and screen recorders do.
# One that is shown again changes less of the one before it than a new one does, at places that follow the two clocks:
# of n frames m are new, spread evenly (Bresenham's pattern). Others make such patterns: a vibration or a light whose
# period is a whole number of frames stands still at its turning points, but then all its pictures come back after n
# or 2 n frames, which new pictures do not; and the codec. The shortest pattern that is none of these counts.
FEWEST = 10  # times that a pattern comes
LARGEST = 30  # n
ORDERED = 0.93  # of the pairs of a repeat and a new picture, that the repeat changes less in
FAINT = 0.25  # of the median change of new pictures, that the median repeat changes at most
CODEC = 0.95  # of the frames, that follow the codec's kinds of frames: such a pattern is taken for the codec's own,
EQUAL = 0.1  # but where nine repeats in ten change less than this part
COMES_BACK = 0.25  # of what a new picture changes, that one n or 2 n frames later differs by where the scene comes back


@dataclass(frozen=True)
class Repeats:
    """The pattern of a file's repeats."""

    share: Fraction  # m / n of its frames are new pictures
    is_new: np.ndarray  # [T] bool

    @property
    def rows(self) -> tuple[int, ...]:
        """The frames that show the picture before them again."""
        return tuple(np.flatnonzero(~self.is_new).tolist())

    def times(self, fps: Fraction) -> list[Fraction]:
        """When the new pictures were taken, seconds from the first; of a file of `fps` frames per second."""
        return [k / (fps * self.share) for k in range(int(self.is_new.sum()))]


def find_repeats(
    changes: np.ndarray, pictures: np.ndarray, is_between: np.ndarray, is_key: np.ndarray
) -> Repeats | None:
    """The pattern in which frames [T] repeat the one before them, None where there is none.

    changes: mean absolute change of each frame from the one before it, grey levels; the first is not looked at.
    pictures [T, B]: the same frames, small. is_between, is_key: bool, how the codec made them.
    """
    rank = np.empty(len(changes) - 1)
    rank[np.argsort(changes[1:], kind="stable")] = np.arange(len(rank))
    keys = np.diff(np.flatnonzero(is_key))
    for n in range(2, min(LARGEST, len(changes) // FEWEST) + 1):
        pattern = max(_patterns(n), key=lambda p: _ordered(rank, _repeated(p, len(changes))[1:]))
        is_new = _repeated(pattern, len(changes))
        new, again = changes[1:][is_new[1:]], changes[1:][~is_new[1:]]
        if _ordered(rank, is_new[1:]) < ORDERED or np.median(again) > FAINT * np.median(new):
            continue
        is_codecs = (is_new == ~is_between)[1:].mean() > CODEC
        if (len(keys) and np.median(keys) == n) or (
            is_codecs and np.quantile(again, 0.9) > EQUAL * np.median(new)
        ):
            continue
        if not _comes_back(pictures, is_new, n):
            return Repeats(Fraction(sum(pattern), n), is_new)
    return None


@lru_cache
def _patterns(n: int) -> list[tuple[bool, ...]]:
    """All patterns of n frames, of which any but all are new, that no shorter one makes."""
    out = set()
    for m in range(1, n):
        if np.gcd(m, n) == 1:
            word = np.diff(np.arange(n + 1) * m // n) > 0
            out |= {tuple(np.roll(word, k).tolist()) for k in range(n)}
    return sorted(out)


def _repeated(pattern: tuple[bool, ...], length: int) -> np.ndarray:
    """[T] bool; the first frame is new whatever the pattern says."""
    out = np.resize(np.array(pattern), length)
    out[0] = True
    return out


def _ordered(rank: np.ndarray, is_new: np.ndarray) -> float:
    """Share of pairs of a repeat and a new picture in which the new one ranks higher (Mann & Whitney 1947)."""
    high = int(is_new.sum())
    low = len(rank) - high
    return float(rank[is_new].sum() - high * (high - 1) / 2) / max(high * low, 1)


def _comes_back(pictures: np.ndarray, is_new: np.ndarray, n: int) -> bool:
    """Whether pictures are like those n or 2 n frames before them."""
    new = np.flatnonzero(is_new)

    def differ(frames: int) -> float:
        at = new[new >= frames]
        return float(np.median(np.abs(pictures[at] - pictures[at - frames]).mean(1)))

    return min(differ(n), differ(2 * n)) < COMES_BACK * differ(1)


RECENT = 4  # frames; more than B pictures stand between others in most videos
BLOCK = 8  # pixels of the thinned picture
CHANGED = 0.1  # mean absolute difference of a block, grey levels of 255, above which it has changed
SILENT = 0.003  # share of new blocks in a quarter of the frames or more, at most, of a frozen recording
QUIET = 0.05  # the same in its median frame
BUSY = 0.5  # share of the frames in which a block is new that shows something that moves
ALIVE = 0.2  # share of new blocks in a fifth of the frames of a recording whose still frames stand out,
STILL = 0.02  # those with fewer new blocks than this
NOISE = 1.3  # grey levels between successive key frames that are a sensor's noise, where it is
EVEN = 0.75  # as large between all of them
FEWEST_KEYS = 3  # changes between key frames, after the first, that tell noise from one picture
UNCHANGED = 1e-3  # mean change from frame to frame, grey levels, below which nothing but the codec works
LIVELY = 0.5  # share of new blocks in each of
LIVELY_RUN = 10  # successive frames of a recording that is not frozen all along
SHORTEST = 5  # frames of a frozen run
LIT = 0.5  # grey levels that the picture's mean goes up and down by, where the light changes
RELIT = 0.6  # mean change of a block beyond gain and offset, grey levels, that is more than light, rounded to 8 bits
GAP = 2  # frames between two runs that make no end of them: a key frame and what follows it


class NoveltyMeter:
    """What is new in each frame of a recording."""

    def __init__(self) -> None:
        self._recent: deque[np.ndarray] = deque(maxlen=RECENT)
        self._key: np.ndarray | None = None
        self._key_changes: list[float] = []
        self._news: list[float] = []  # share of new blocks, from the second frame that is not black on
        self._changes: list[float] = []  # mean change of the same frames
        self._at: list[int] = []  # the frames that these are of
        self._relit: list[float] = []  # share of blocks that change by more than light, of the same frames
        self._blocks: list[np.ndarray] = []  # which blocks are new, packed bits, of the same frames
        self._small: list[np.ndarray] = []  # means of the blocks of each frame
        self._brightness: list[float] = []  # means of all frames
        self._is_between: list[bool] = []
        self._is_key: list[bool] = []

    def add(self, grey: np.ndarray, is_key: bool, is_between: bool) -> None:
        """grey [h, w] uint8, thinned: every so-many-th pixel, as an average would take the noise away."""
        self._count(float(grey.mean()), is_key, is_between)
        height, width = (n // min(BLOCK, n) * min(BLOCK, n) for n in grey.shape)
        grey = grey[:height, :width].astype(np.int16)
        self._small.append(_in_blocks(grey).mean(2).ravel().astype(np.float16))
        if self._recent:
            new = np.min([_block_changes(grey, before) for before in self._recent], axis=0) > CHANGED
            self._news.append(float(new.mean()))
            self._at.append(len(self._brightness) - 1)
            self._changes.append(float(np.abs(grey - self._recent[-1]).mean()))
            self._relit.append(float((_unlike(grey, self._recent[-1]) > RELIT).mean()))
            self._blocks.append(np.packbits(new))
        self._recent.append(grey)
        if is_key:
            if self._key is not None:
                self._key_changes.append(float(np.abs(grey - self._key).mean()))
            self._key = grey

    def add_black(self, is_key: bool, is_between: bool) -> None:
        """A frame that shows nothing."""
        self._count(0.0, is_key, is_between)

    def _count(self, brightness: float, is_key: bool, is_between: bool) -> None:
        self._brightness.append(brightness)
        self._is_key.append(is_key)
        self._is_between.append(is_between)

    @cached_property
    def repeats(self) -> Repeats | None:
        """The pattern in which frames are shown again; ask when all frames are there."""
        if len(self._at) < len(self._brightness) - 1:
            return None  # black ones among them
        changes, pictures = np.array([0, *self._changes]), np.array(self._small, np.float32)
        return find_repeats(changes, pictures, np.array(self._is_between), np.array(self._is_key))

    @property
    def _told(self) -> np.ndarray:
        """[n] bool: of the frames that have news, those that are no repeats."""
        return np.ones(len(self._at), bool) if self.repeats is None else self.repeats.is_new[self._at]

    @property
    def _is_lit(self) -> bool:
        seen = np.array(self._brightness)[self._at]
        return bool(np.ptp(np.quantile(seen, (0.05, 0.95))) > LIT)

    def is_frozen(self) -> bool:
        """Whether all frames that show something are one picture, surely: nothing changes, or key frames tell."""
        return (
            self.hardly_changes()
            and not self._is_lit
            and (float(np.median(self._changes)) < UNCHANGED or len(self._key_changes) > FEWEST_KEYS)
        )

    def hardly_changes(self) -> bool:
        """Whether all frames are one picture, or show a still scene whose noise the codec took away."""
        news = np.array(self._news)[self._told]
        if not len(news) or any(stop - first >= LIVELY_RUN for first, stop in runs(news >= LIVELY)):
            return False
        silent, median = np.quantile(news, (0.25, 0.5))
        busy = np.unpackbits(np.stack(self._blocks)[self._told], axis=1).sum(0)
        busiest = busy.max() / len(news)
        return bool(silent <= SILENT and median < QUIET and busiest < BUSY and not self._keys_differ())

    def _keys_differ(self) -> bool:
        """Whether key frames tell of noise that the frames between them have lost. The first one is coarser."""
        changes = self._key_changes[1:]
        return len(changes) >= FEWEST_KEYS and min(changes) >= max(NOISE, EVEN * max(changes))

    def frozen_frames(self) -> np.ndarray:
        """[T] bool: frames of runs of one picture in a recording that is alive otherwise; repeats are not counted."""
        length, told = len(self._brightness), self._told
        frozen = np.zeros(length, bool)
        alive = np.array(self._relit if self._is_lit else self._news)[told]
        if not len(alive) or np.quantile(alive, 0.8) < ALIVE:
            return frozen
        kept = np.arange(length) if self.repeats is None else np.flatnonzero(self.repeats.is_new)
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
    """[rows, columns, pixels] of each block."""
    rows, columns = (min(BLOCK, n) for n in grey.shape)
    height, width = grey.shape
    blocks = grey.reshape(height // rows, rows, width // columns, columns)
    return blocks.transpose(0, 2, 1, 3).reshape(height // rows, width // columns, -1)


def _block_changes(grey: np.ndarray, other: np.ndarray) -> np.ndarray:
    return _in_blocks(np.abs(grey - other)).mean(axis=2)


def _unlike(grey: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The same, less what a gain and an offset of each block explain."""
    a, b = (_in_blocks(g).astype(np.float32) for g in (grey, other))
    a, b = a - a.mean(2, keepdims=True), b - b.mean(2, keepdims=True)
    gain = (a * b).sum(2, keepdims=True) / np.maximum((b * b).sum(2, keepdims=True), 1e-6)
    return np.asarray(np.abs(a - gain * b).mean(2))
