"""Whether a recording shows one picture for a while, or hardly changes at all, but for what its codec does to it.

A sensor's noise and a scene's motion change blocks of the picture in nearly every frame. A codec that is fed one
picture changes it at its key frames, refines it after them, and goes back and forth between its kinds of frames, to
pictures that were there a moment before. So a block counts as new where it is unlike each of the last RECENT frames.

Light that flickers changes a still picture from frame to frame and comes back too. A picture whose brightness changes
is not frozen; and a run of it is found only in a recording in which more than the light changes otherwise.
"""

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
        self._at: list[int] = []  # the frames that these are of
        self._relit: list[float] = []  # share of blocks that change by more than light, of the same frames
        self._blocks: list[np.ndarray] = []  # which blocks are new, packed bits, of the same frames
        self._brightness: list[float] = []  # means of all frames

    def add(self, grey: np.ndarray, is_key: bool) -> None:
        """Look at grey [h, w] uint8, thinned: every so-many-th pixel, as an average would take the noise away."""
        self._brightness.append(float(grey.mean()))
        height, width = (n // min(BLOCK, n) * min(BLOCK, n) for n in grey.shape)
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
        """Whether all frames are one picture, or show a still scene whose noise the codec took away.

        is_new [T] bool: frames that are no duplicates.
        """
        told = is_new[self._at]
        news = np.array(self._news)[told]
        if not len(news) or any(stop - first >= LIVELY_RUN for first, stop in runs(news >= LIVELY)):
            return False
        silent, median = np.quantile(news, (0.25, 0.5))
        busy = np.unpackbits(np.stack(self._blocks)[told], axis=1).sum(0)
        busiest = busy.max() / len(news)
        return bool(silent <= SILENT and median < QUIET and busiest < BUSY and not self._keys_differ())

    def _keys_differ(self) -> bool:
        """Whether key frames tell of noise that the frames between them have lost. The first one is coarser."""
        changes = self._key_changes[1:]
        return len(changes) >= FEWEST_KEYS and min(changes) >= max(NOISE, EVEN * max(changes))

    def frozen_frames(self, is_new: np.ndarray) -> np.ndarray:
        """[T] bool: frames of runs of one picture in a recording that is alive otherwise.

        is_new [T] bool: frames that are no duplicates; the others are not counted.
        """
        length, told = len(self._brightness), is_new[self._at]
        frozen = np.zeros(length, bool)
        alive = np.array(self._relit if self._is_lit else self._news)[told]
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
