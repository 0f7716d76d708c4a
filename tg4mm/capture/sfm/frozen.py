"""Whether a recording shows one picture all along, or for a while, but for what its codec does to it.

A sensor's noise and a scene's motion change blocks of the picture in nearly every frame. A codec that is fed one
picture changes it at its key frames, refines it after them, and goes back and forth between its kinds of frames, to
pictures that were there a moment before. So a block counts as new where it is unlike each of the last RECENT frames.
"""

from __future__ import annotations

from collections import deque
from itertools import pairwise

import numpy as np

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
GAP = 2  # frames between two runs that make no end of them: a key frame and what follows it


class NoveltyMeter:
    """What is new in each frame of a recording."""

    def __init__(self) -> None:
        self._recent: deque[np.ndarray] = deque(maxlen=RECENT)
        self._key: np.ndarray | None = None
        self._key_changes: list[float] = []
        self._length = 0
        self._news: list[float] = []  # share of new blocks, from the second frame that is not black on
        self._changes: list[float] = []  # mean change of the same frames
        self._at: list[int] = []  # the frames that these are of
        self._busy: np.ndarray | None = None  # frames in which each block was new

    def add(self, grey: np.ndarray, is_key: bool) -> None:
        """grey [h, w] uint8, thinned: every so-many-th pixel, as an average would take the noise away."""
        self._length += 1
        height, width = (n // min(BLOCK, n) * min(BLOCK, n) for n in grey.shape)
        grey = grey[:height, :width].astype(np.int16)
        if self._recent:
            new = np.min([_block_changes(grey, before) for before in self._recent], axis=0) > CHANGED
            self._news.append(float(new.mean()))
            self._at.append(self._length - 1)
            self._changes.append(float(np.abs(grey - self._recent[-1]).mean()))
            self._busy = new.astype(int) if self._busy is None else self._busy + new
        self._recent.append(grey)
        if is_key:
            if self._key is not None:
                self._key_changes.append(float(np.abs(grey - self._key).mean()))
            self._key = grey

    def add_black(self) -> None:
        """A frame that shows nothing."""
        self._length += 1

    def is_frozen(self) -> bool:
        """Whether all frames that show something are one picture, surely: nothing changes, or key frames tell."""
        return self.hardly_changes() and (
            float(np.median(self._changes)) < UNCHANGED or len(self._key_changes) > FEWEST_KEYS
        )

    def hardly_changes(self) -> bool:
        """Whether all frames are one picture, or show a still scene whose noise the codec took away."""
        if self._busy is None or any(
            stop - first >= LIVELY_RUN for first, stop in runs(np.array(self._news) >= LIVELY)
        ):
            return False
        silent, median = np.quantile(self._news, (0.25, 0.5))
        busiest = self._busy.max() / len(self._news)
        return bool(silent <= SILENT and median < QUIET and busiest < BUSY and not self._keys_differ())

    def _keys_differ(self) -> bool:
        """Whether key frames tell of noise that the frames between them have lost. The first one is coarser."""
        changes = self._key_changes[1:]
        return len(changes) >= FEWEST_KEYS and min(changes) >= max(NOISE, EVEN * max(changes))

    def frozen_frames(self) -> np.ndarray:
        """[T] bool: frames of runs of one picture in a recording that is alive otherwise."""
        frozen = np.zeros(self._length, bool)
        if not self._news or np.quantile(self._news, 0.8) < ALIVE:
            return frozen
        still = np.zeros(self._length, bool)
        still[self._at] = np.array(self._news) < STILL
        for first, stop in runs(still, GAP):
            if stop - first >= SHORTEST:
                frozen[first:stop] = True
        return frozen


def runs(flags: np.ndarray, gap: int = 0) -> list[tuple[int, int]]:
    """First frame and end (not included) of each run of true flags [T]; those at most `gap` frames apart are one."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    found = [(int(first), int(stop)) for first, stop in edges.reshape(-1, 2)]
    apart = [after[0] - before[1] > gap for before, after in pairwise(found)]
    starts = [run[0] for run, new in zip(found, [True, *apart], strict=False) if new]
    stops = [run[1] for run, new in zip(found, [*apart, True], strict=False) if new]
    return list(zip(starts, stops, strict=True))


def _block_changes(grey: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Mean absolute difference of each block."""
    rows, columns = (min(BLOCK, n) for n in grey.shape)
    height, width = grey.shape
    blocks = np.abs(grey - other).reshape(height // rows, rows, width // columns, columns)
    return blocks.mean(axis=(1, 3))
