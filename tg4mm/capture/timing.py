"""When pictures were taken, and what kind of capture their cameras make (docs/conventions.md)."""

from collections.abc import Sequence

import numpy as np

from tg4mm.core.choices import Clock, Kind
from tg4mm.core.errors import CaptureError

# Of several fixed cameras: synchronous, their times are of one clock; independent, each has a clock of its own.
CLOCKS = (Clock.synchronous, Clock.independent)
FEWEST_FRAMES = 6  # of a fixed camera that shows motion: fewer tell no frequency below half the frame rate
FEWEST_MOVING = 8  # of a moving camera
NEARLY_ALL = 0.9  # of the timesteps, for a camera to count as one that stayed put
TOLERANCE = 0.01  # of 1 / fps, that the median step of a camera's times may be off


def times_of_timesteps(timesteps: np.ndarray, fps: float) -> np.ndarray:
    """[C] float64, seconds: t / fps; zeros where the frame rate is not known (fps = 0)."""
    return timesteps / fps if fps else np.zeros(len(timesteps))


def kind_of_cameras(camera_ids: np.ndarray, timesteps: np.ndarray, n_timesteps: int) -> Kind:
    """The kind, from how many cameras have a picture at (nearly) every timestep. Never flat nor clips."""
    if n_timesteps == 1:
        return Kind.photos
    pairs = np.unique(np.stack([camera_ids, timesteps]), axis=1)
    counts = np.unique(pairs[0], return_counts=True)[1]
    fixed = int((counts >= max(2, NEARLY_ALL * n_timesteps)).sum())
    return next(kind for kind in Kind if kind.n_fixed == min(fixed, 2))


def check_times(
    where: str, times_s: np.ndarray, timesteps: np.ndarray, cameras: Sequence[str], fps: float
) -> None:
    """Raise CaptureError where a camera's times contradict fps: the median of their steps is not 1 / fps.

    where: the file that says fps. times_s [C] in seconds (NaN: not known), of pictures by `cameras` [C] at timesteps
    [C]. Single steps may differ: phones drop frames. Where no name comes back in a later timestep, as with frames that
    are numbered, the medians of the timesteps stand for a camera.
    """
    names, known = np.array(cameras), np.isfinite(times_s)
    checked = False
    for camera in dict.fromkeys(cameras):
        rows = np.flatnonzero((names == camera) & known)
        rows = rows[np.argsort(timesteps[rows], kind="stable")]
        if len(rows) < 2 or (np.diff(timesteps[rows]) == 0).any():
            continue
        _check_steps(where, f"camera {camera}", times_s[rows], timesteps[rows], fps)
        checked = True
    steps = np.unique(timesteps[known])
    if not checked and len(steps) > 1:
        medians = np.array([np.median(times_s[known & (timesteps == t)]) for t in steps])
        _check_steps(where, "the pictures", medians, steps, fps)


def _check_steps(where: str, whose: str, times_s: np.ndarray, timesteps: np.ndarray, fps: float) -> None:
    step = float(np.median(np.diff(times_s) / np.diff(timesteps)))
    if not abs(step * fps - 1) <= TOLERANCE:
        rate = f"{1 / step:.6g} Hz" if step > 0 else "no frame rate"
        raise CaptureError(
            f"{where}: fps is {fps:.6g}, but the times of {whose} step by {step:.6g} s ({rate}): "
            "correct fps, or the frames' time"
        )
