"""Exposure and white balance of a fixed camera over time: a phone changes both automatically, in steps."""

import warnings
from collections.abc import Iterable

import numpy as np
from scipy.ndimage import median_filter

from tg4mm.capture.sfm.survey import Survey

_SECONDS = 0.3  # that a value is the median of
_SAID = 0.02  # relative, of a change that is said


def warn_light(surveys: Iterable[Survey]) -> None:
    """A warning for each recording of a fixed camera whose light or white balance changes by over 2 %."""
    for survey in surveys:
        if survey.times is None or len(survey.light) < len(survey):
            continue
        times = np.array([float(time) for time in survey.times])
        found = [_change(times, survey.light[:, :1]), _change(times, survey.light[:, 1:])]
        told = [
            f"{what} changes by {size:.2g} of it, fastest at {at:.1f} s"
            for what, (size, at) in zip(("exposure", "white balance"), found, strict=True)
            if size > _SAID
        ]
        if told:
            warnings.warn(
                f"{survey.path.name}: {' and '.join(told)}; changes common to all of the picture are "
                "removed; lock both in the camera",
                stacklevel=2,
            )


def _change(times_s: np.ndarray, logs: np.ndarray) -> tuple[float, float]:
    """The largest relative change of logarithms [T, k], and when it is fastest, seconds."""
    window = 2 * max(round(_SECONDS / 2 / float(np.median(np.diff(times_s)))), 1) + 1
    smooth = median_filter(logs, (window, 1), mode="nearest")
    if len(smooth) <= window:
        return 0.0, 0.0
    k = int(np.ptp(smooth, axis=0).argmax())
    at = int(np.abs(smooth[window:, k] - smooth[:-window, k]).argmax()) + window // 2
    return float(np.expm1(np.ptp(smooth[:, k]))), float(times_s[at])
