"""Duplicate frames of a recording: pictures that its file shows more than once.

Downloads and screen recorders store 25 pictures a second as 30, or show one again where the next was late. A duplicate
frame shows the picture before it again everywhere, its noise too: where a new picture would change, blocks are
identical bit for bit, or, in a regular pattern, all change clearly less. Little change alone is no evidence:

- a vibration stands still at its turning points, a light at its extremes: what does not move still shows its noise,
  and if the codec took the noise away, frames near other turning points change as little (`_stands_out`);
- if a period of the motion is a whole number of frames, pictures come back after it (`_comes_back`);
- a codec skips blocks of the frames that it predicts. It does so by the frames' kinds: duplicates change less than new
  pictures of the same kind (`_kinds`), and more clearly so where their kinds differ throughout.

A regular pattern (n frames with m new pictures, spread evenly) is looked for first; then single frames, which count
only in a recording in which the noise changes every new picture.
"""

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache

import numpy as np
from scipy.stats import rankdata

OFF = "--keep-duplicates"  # the option that switches the detection off
BLOCK = 8  # pixels a side, as codecs' smallest common transform
_PIXELS = 30_000  # about, of a frame, that are looked at
_FEWEST = 10  # times that a pattern comes
_LARGEST = 30  # n
_ORDERED = 0.93  # of the pairs of a duplicate and a new picture, that the duplicate changes less in,
_ORDERED_BLOCKS = 0.9  # and has more identical blocks in; in pairs of frames of one kind as well
_COMPARED = 0.5  # of the duplicates, that need a new picture of their kind for that
_SELDOM = 0.25  # of the new pictures: a block identical in no more of them shows noise or motion
_IDENTICAL = 0.4  # of these blocks, in the median duplicate of a pattern
_CLEARLY = 0.5  # of them, in nine duplicates of ten where the codec makes no new picture in the same way
_BESIDE = 0.5  # of that, at most, in nine new pictures of ten
_GAP = 0.45  # of the change that nine new pictures of ten exceed, at most, in nine duplicates of ten
_CODED_AGAIN = (
    0.6  # the same, and of each block's median change, where a codec stores the repeated picture anew,
)
_NEARLY_ALL = 0.95  # of the blocks: a new picture's noise changes them all, a vibration only what moves
_COMES_BACK = (
    0.25  # of a new picture's change, that one n or 2 n frames later differs by where the scene comes back
)
# Without a pattern:
_ALONE = 0.8  # of the blocks that show noise or motion, identical in a duplicate
_BETWEEN = 0.2  # of them, from which on a frame is neither
_UNSURE = 0.2  # of the duplicates' number, frames that are neither, at most
_ALONE_SELDOM = 0.6  # of all frames: a block identical in no more of them shows noise or motion
_ALONE_BLOCKS = 0.5  # of all blocks, that do
# of a new picture's median change, that four of five exceed where noise changes them all; of a vibration's pictures
# without noise, whose changes go by |sin|, .44 of the median
_FLOOR = 0.6
_NOTHING = 0.1  # of it, that nine of ten duplicates do not reach
_ALONE_FEWEST, _ALONE_MOST = 5, 0.6  # duplicates, and share of the frames
_ALONE_RUN = 4  # duplicates in a row, at most: more are a frozen picture


@dataclass(frozen=True)
class Duplicates:
    """The duplicate frames and their pattern."""

    is_new: np.ndarray  # [T] bool
    share: Fraction | None  # m / n of the frames are new pictures, in a pattern; None: no pattern

    @property
    def rows(self) -> tuple[int, ...]:
        """The frames that show the picture before them again."""
        return tuple(np.flatnonzero(~self.is_new).tolist())

    def times(self, fps: Fraction) -> list[Fraction]:
        """Return the times of the new pictures, seconds from the first frame of a file of `fps` frames per second.

        In a pattern they were taken at equal distances; without one each was when it is first shown.
        """
        if self.share is None:
            return [int(k) / fps for k in np.flatnonzero(self.is_new)]
        return [k / (fps * self.share) for k in range(int(self.is_new.sum()))]


@dataclass
class DuplicateMeter:
    """Collects what `find_duplicates` needs, frame by frame."""

    _before: np.ndarray | None = None
    _changes: list[float] = field(default_factory=list)
    _by_block: list[np.ndarray] = field(default_factory=list)
    _identical: list[np.ndarray] = field(default_factory=list)
    _small: list[np.ndarray] = field(default_factory=list)
    _kinds: list[str] = field(default_factory=list)

    def add(self, grey: np.ndarray, is_key: bool, is_between: bool) -> None:
        """Look at the next frame [H, W], as it was decoded: neither averaged nor scaled."""
        now = _blocks(grey)
        now = now.astype(np.int16) if now.dtype == np.uint8 else now
        change = np.zeros(now.shape) if self._before is None else np.abs(now - self._before)
        self._changes.append(float(change.mean()))
        self._by_block.append(change.mean(1).astype(np.float16))
        self._identical.append(np.packbits(change.max(1) == 0))
        self._small.append(now.mean(1).astype(np.float16))
        self._kinds.append("I" if is_key else "B" if is_between else "P")
        self._before = now

    def found(self, irregular: bool = True) -> Duplicates | None:
        """Return the duplicates among the frames so far; irregular: those without a pattern, too."""
        if len(self._changes) < 2 * _FEWEST:
            return None
        small = np.array(self._small, np.float32)
        identical = np.unpackbits(np.stack(self._identical), axis=1, count=small.shape[1]).astype(bool)
        by_block = np.array(self._by_block, np.float32)
        return find_duplicates(
            np.array(self._changes), by_block, identical, small, "".join(self._kinds), irregular
        )


def find_duplicates(
    changes: np.ndarray,
    by_block: np.ndarray,
    identical: np.ndarray,
    pictures: np.ndarray,
    kinds: str,
    irregular: bool = True,
) -> Duplicates | None:
    """The duplicate frames among T, None where the evidence shows none.

    changes [T], by_block [T, B]: mean absolute change from the frame before; identical [T, B] bool: blocks that are bit
    for bit those of the frame before; the first of each is not looked at. pictures [T, B]: the same frames, small.
    kinds: T letters I, P or B, how the codec made each. irregular: without a pattern, too.
    """
    rank, places = rankdata(changes[1:]), _kinds_of(kinds)
    for n in range(2, min(_LARGEST, len(changes) // _FEWEST) + 1):
        pattern = max(_patterns(n), key=lambda p: _ordered(rank, _repeated(p, len(changes))[1:]))
        is_new = _repeated(pattern, len(changes))
        if _ordered(rank, is_new[1:]) < _ORDERED or _is_of_keys(n, kinds):
            continue
        gap, shows = _gap(changes, is_new), identical[is_new].mean(0) <= _SELDOM
        is_again = gap <= _GAP and _stands_out(identical[:, shows], is_new, places)
        is_again |= gap <= _CODED_AGAIN and _changes_less_everywhere(changes, by_block, is_new, places)
        if is_again and not _comes_back(pictures[:, shows], is_new, (n, 2 * n)):
            return Duplicates(is_new, Fraction(sum(pattern), n))
    return _without_pattern(changes, identical, pictures, places) if irregular else None


def _blocks(grey: np.ndarray) -> np.ndarray:
    """Return [B, pixels] of some of a picture's blocks, spread evenly."""
    rows, columns = (min(BLOCK, n) for n in grey.shape)
    step = max(1, round((grey.size / _PIXELS) ** 0.5))
    height, width = (n // size * size for n, size in zip(grey.shape, (rows, columns), strict=True))
    blocks = grey[:height, :width].reshape(height // rows, rows, width // columns, columns)[::step, :, ::step]
    return blocks.transpose(0, 2, 1, 3).reshape(-1, rows * columns)


@lru_cache
def _patterns(n: int) -> list[tuple[bool, ...]]:
    """Return all patterns of n frames with some new and some not (Bresenham's) that no shorter pattern makes."""
    out = set()
    for m in range(1, n):
        if np.gcd(m, n) == 1:
            word = np.diff(np.arange(n + 1) * m // n) > 0
            out |= {tuple(np.roll(word, k).tolist()) for k in range(n)}
    return sorted(out)


def _repeated(pattern: tuple[bool, ...], length: int) -> np.ndarray:
    """Return [T] bool; the first frame is new whatever the pattern says."""
    out = np.resize(np.array(pattern), length)
    out[0] = True
    return out


def _ordered(rank: np.ndarray, is_new: np.ndarray) -> float:
    """Share of pairs of a duplicate and a new picture in which the new one ranks higher (Mann & Whitney 1947)."""
    high = int(is_new.sum())
    low = len(rank) - high
    return float(rank[is_new].sum() - high * (high + 1) / 2) / max(high * low, 1)


def _kinds_of(kinds: str) -> list[tuple[str, int, int]]:
    """Return each frame's kind as a letter, with its position between frames that are not B-frames."""
    at = np.flatnonzero([kind != "B" for kind in kinds])
    frames = np.arange(len(kinds))
    before = np.concatenate([[-1], at])[np.searchsorted(at, frames, "left")]
    after = np.concatenate([at, [len(kinds)]])[np.searchsorted(at, frames, "left")]
    return [
        (kind, int(k - b), int(a - k)) for k, kind, b, a in zip(frames, kinds, before, after, strict=True)
    ]


def _is_of_keys(n: int, kinds: str) -> bool:
    """Return whether the codec's key frames follow each other at that distance, or at one that divides it."""
    steps = np.diff([k for k, kind in enumerate(kinds) if kind == "I"])
    usual = int(np.median(steps)) if len(steps) else 0
    return usual > 1 and n % usual == 0


def _gap(changes: np.ndarray, is_new: np.ndarray) -> float:
    """Return the change in most duplicates over that in nearly all new pictures: not small near turning points."""
    new, changes = is_new[1:], changes[1:]
    return float(np.quantile(changes[~new], 0.9) / max(np.quantile(changes[new], 0.1), 1e-9))


def _changes_less_everywhere(
    changes: np.ndarray, by_block: np.ndarray, is_new: np.ndarray, places: Sequence[Hashable]
) -> bool:
    """Return whether nearly all blocks change clearly less in duplicates, in frames of one kind too."""
    new, by_block = is_new[1:], by_block[1:]
    fewer = np.median(by_block[~new], 0) < _CODED_AGAIN * np.median(by_block[new], 0)
    return bool(fewer.mean() >= _NEARLY_ALL) and _stands_out_in_kind(-changes[1:], new, places[1:])


def _stands_out(identical: np.ndarray, is_new: np.ndarray, places: Sequence[Hashable]) -> bool:
    """Return whether blocks that show noise or motion are identical in duplicates only, not in new pictures."""
    if not identical.shape[1]:
        return False
    new, share = is_new[1:], identical[1:].mean(1)
    again = float(np.median(share[~new]))
    return (
        again >= _IDENTICAL
        and float(np.quantile(share[new], 0.9)) <= _BESIDE * again
        and _ordered(rankdata(-share), new) >= _ORDERED_BLOCKS
        and _stands_out_in_kind(share, new, places[1:])
    )


def _stands_out_in_kind(share: np.ndarray, is_new: np.ndarray, places: Sequence[Hashable]) -> bool:
    """Return whether duplicates have more identical blocks than new pictures that the codec makes in the same way.

    If it encodes most of the duplicates unlike any new picture, their share must be large.
    """
    rows: dict[Hashable, list[int]] = {}
    for k, place in enumerate(places):
        rows.setdefault(place, []).append(k)
    right = pairs = compared = 0.0
    for alike in rows.values():
        new = is_new[alike]
        count = int(new.sum()) * int((~new).sum())
        if count:
            right += count * _ordered(rankdata(-share[alike]), new)
            pairs += count
            compared += int((~new).sum())
    if compared < _COMPARED * int((~is_new).sum()):
        return bool(np.quantile(share[~is_new], 0.1) >= _CLEARLY)
    return right / pairs >= _ORDERED_BLOCKS


def _comes_back(pictures: np.ndarray, is_new: np.ndarray, after: Iterable[int]) -> bool:
    """Return whether pictures are like those so many frames before them, any of the numbers given."""
    new = np.flatnonzero(is_new)

    def differ(frames: int) -> float:
        at = new[new >= frames]
        return float(np.median(np.abs(pictures[at] - pictures[at - frames]).mean(1)))

    return min(differ(n) for n in after) < _COMES_BACK * differ(1)


def _without_pattern(
    changes: np.ndarray, identical: np.ndarray, pictures: np.ndarray, places: Sequence[tuple[str, int, int]]
) -> Duplicates | None:
    """Single duplicates, where noise changes most blocks of every new picture, of every kind of frame."""
    shows = identical[1:].mean(0) <= _ALONE_SELDOM
    if shows.mean() < _ALONE_BLOCKS:
        return None
    share = identical[:, shows].mean(1)
    again, unsure = share >= _ALONE, (share >= _BETWEEN) & (share < _ALONE)
    again[0] = unsure[0] = False
    new = ~again
    count, between_new = int(again.sum()), changes[1:][new[1:]]
    # B-frames and the frame after them are coded together: if a codec skips them all, that is one decision.
    groups = {k + place[2] for k, place in enumerate(places) if again[k]}
    if not _ALONE_FEWEST <= count <= _ALONE_MOST * len(changes) or unsure.sum() > _UNSURE * count:
        return None
    if len(groups) < _ALONE_FEWEST:
        return None
    usual = float(np.median(between_new))
    if np.quantile(between_new, 0.2) < _FLOOR * usual or np.quantile(changes[again], 0.9) > _NOTHING * usual:
        return None
    if max(np.diff(np.flatnonzero([*new, True])), default=1) > _ALONE_RUN + 1:
        return None
    if _comes_back(pictures, new, range(2, min(_LARGEST, len(changes) // 4))):
        return None
    kinds = {place for place, is_new in zip(places, new, strict=True) if is_new}
    compared = sum(place in kinds for place, is_again in zip(places, again, strict=True) if is_again)
    return Duplicates(new, None) if compared >= _COMPARED * count else None
