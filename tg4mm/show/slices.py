"""Pictures of motion over time: space-time slices, difference maps, and the spectrum of a motion."""

from typing import Literal

import numpy as np

from tg4mm.fit.motion.modes import ModalMotion

Axis = Literal["row", "column"]


def space_time_slice(video: np.ndarray, axis: Axis, index: int) -> np.ndarray:
    """One line of pixels over time.

    `video` is [T, H, W, 3] (or [T, H, W]). A row gives [T, W, 3], time running down; a column gives
    [H, T, 3], time running right. Raises ValueError for an axis or index that the video does not have.
    """
    video = _check_video(video)
    length = {"row": video.shape[1], "column": video.shape[2]}.get(axis)
    if length is None:
        raise ValueError(f"axis is {axis!r}, expected 'row' or 'column'")
    if not 0 <= index < length:
        raise ValueError(f"{axis} {index} is outside the video's {length} {axis}s")
    return video[:, index].copy() if axis == "row" else np.swapaxes(video[:, :, index], 0, 1).copy()


def most_moving_line(video: np.ndarray, axis: Axis | None = None) -> tuple[Axis, int]:
    """Return axis and index of the row or column of [T, H, W, 3] with the largest mean variance over time.

    With `axis` given, the line of that axis. Where nothing varies it is the middle row (column).
    """
    video = _check_video(video).astype(np.float64)
    variance = video.var(axis=0)
    variance = variance.mean(axis=-1) if variance.ndim == 3 else variance  # [H, W]
    lines: dict[Axis, np.ndarray] = {"row": variance.mean(axis=1), "column": variance.mean(axis=0)}
    if axis is not None:
        lines = {axis: lines[axis]}
    best: Axis = max(lines, key=lambda a: float(lines[a].max()))
    line = lines[best]
    return best, int(line.argmax()) if line.max() > 0 else len(line) // 2


def difference_maps(video: np.ndarray, count: int | None = None) -> tuple[np.ndarray, float]:
    """([n, H, W] maps, scale): D_t(p) = |I(p, t + 1) − I(p, t)|, [TG4MM] Eq. (17), mean over channels.

    The first `count` maps of a video [T, H, W, 3] (the paper shows 6 of its first 7 frames), or all T − 1.
    `scale` is the largest value: one colour scale for all maps. To compare several videos, take the largest
    of their scales. Raises ValueError for fewer than two frames or a count outside 1..T − 1.
    """
    video = _check_video(video)
    available = len(video) - 1
    n = available if count is None else count
    if not 1 <= n <= available:
        raise ValueError(f"{n} difference maps asked of {len(video)} frames, expected 1 to {available}")
    maps = np.abs(np.diff(video[: n + 1].astype(np.float64), axis=0))
    maps = maps.mean(axis=-1) if maps.ndim == 4 else maps
    return maps, float(maps.max())


def amplitude_spectrum(
    motion: ModalMotion, weights: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """(frequencies [K] Hz, amplitude [K] scene units): weighted mean over Gaussians of each phasor's length.

    The length of a phasor vector is sqrt(Σ |component|²): for motion along a line, the peak displacement.
    `weights` [N] ≥ 0, all 1 if None. Sorted by frequency. Raises ValueError if the weights do not fit.
    """
    length = np.linalg.norm(motion.displacement.astype(np.complex128), axis=2)  # [K, N]
    weights = np.ones(length.shape[1]) if weights is None else np.asarray(weights, dtype=np.float64)
    if weights.shape != length.shape[1:]:
        raise ValueError(f"weights have shape {weights.shape}, expected {length.shape[1:]}")
    total = weights.sum()
    if not (total > 0 and (weights >= 0).all()):
        raise ValueError(f"weights must be ≥ 0 and not all 0; their sum is {total:g}")
    order = np.argsort(motion.freqs_hz, kind="stable")
    return np.asarray(motion.freqs_hz, dtype=np.float64)[order], (length @ weights / total)[order]


def _check_video(video: np.ndarray) -> np.ndarray:
    video = np.asarray(video)
    if video.ndim not in {3, 4} or 0 in video.shape:
        raise ValueError(f"video has shape {video.shape}, expected [T, H, W, 3] or [T, H, W], not empty")
    return video
