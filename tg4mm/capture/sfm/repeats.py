"""Pictures that a file shows more than once: 25 pictures a second stored as 30, as downloads and screen recorders do.

A picture that is shown again changes less of the one before it than a new one does, at places that follow the two
clocks: of n frames m are new, spread evenly (Bresenham's pattern). Others make such patterns: a vibration or a light
whose period is a whole number of frames stands still at its turning points, but then all its pictures come back after
n or 2 n frames, which new pictures do not; and the codec, with its key frames and its frames between others. The
shortest pattern that is none of these counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

import numpy as np

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
