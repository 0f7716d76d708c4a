"""Figures of a run's stages, which over resumed calls are added, maximised or replaced."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core.errors import RunError
from tg4mm.core.files import to_json
from tg4mm.core.untrusted import read_formed
from tg4mm.core.values import NOT_NEGATIVE, Just, Maybe, Number, check_form

_HZ = [NOT_NEGATIVE]
# of the figures those that something is computed from
_LOG = {
    str: {
        **dict.fromkeys(("seconds?", "peak_memory_mib?", "readout_s?", "picture_gain?"), NOT_NEGATIVE),
        "asked_share?": float,
        "noise_to_motion?": Maybe(NOT_NEGATIVE),
        "duration_s?": Maybe(Number(0, 1e9)),
        **dict.fromkeys(("frequencies_hz?", "lower_bound_hz?", "undetermined_hz?"), _HZ),
        "reliability?": [float],
        "notes?": [str],
        "nuisance?": [str],
        "clip_phases_deg?": {str: {float: float}},
    }
}
FORMAT = "tg4mm-metrics"
_SEEN = {"rms_error": float, "rms_true": float, "static_share": float, "static_leak": Maybe(float)}
_FREQUENCY = {
    "frequency_hz": float,
    "amplitude_true": float,
    "amplitude_estimated": float,
    **{f"{key}?": Maybe(float) for key in ("mac", "amplitude_true_mm", "amplitude_estimated_mm")},
    **dict.fromkeys(
        ("amplitude_ratio", "relative_error", "phase_error_deg", "direction_error_deg"), Maybe(float)
    ),
}
DISPLACEMENT = {
    **_SEEN,
    "relative_error": Maybe(float),
    "per_frequency": [_FREQUENCY],
    "in_band?": Maybe({"relative_error?": Maybe(float)}),
    "uncertainty?": Maybe({"said": float, "within_two": float}),
}
FORM = {
    "format": Just(FORMAT),
    "metrics": [str],
    "alphas": [{"alpha": float, "n_images": int, "rows": {str: {str: Maybe(float)}}}],
    "displacement?": Maybe(DISPLACEMENT),
    "absent": {str: str},
    "notes": [str],
}


def checked_log(log: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return `log`. Raises RunError naming `where` unless it is {stage: figures} with numbers for added figures."""
    try:
        check_form(log, _LOG)
    except ValueError as error:
        raise RunError(f"{where}: {error}") from None
    return dict(log)


def with_figures(log: Mapping[str, Any], stage: str, info: Mapping[str, Any]) -> dict[str, Any]:
    """Return `log` ({stage: figures}) with `info` added to a stage. NaN and infinity become null.

    `seconds` add up (give those since the last record), `peak_memory_mib` keeps the most, anything else
    is replaced. Raises TypeError for what JSON cannot hold.
    """
    entry = dict(log.get(stage, {}))
    for key, value in info.items():
        new = to_json(_finite(value), f"{stage}.{key}")
        old = entry.get(key)
        if key == "seconds":
            new = (old or 0.0) + new
        elif key == "peak_memory_mib" and old is not None:
            new = max(old, new)
        entry[key] = new
    return {**log, stage: entry}


def _finite(value: Any) -> Any:
    """Return `value` with NaN and infinity as None, since the infinite PSNR of equal images must not stop a run."""
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    if isinstance(value, float | np.floating) and not np.isfinite(value):
        return None
    return value


def read_figures(path: Path) -> dict[str, Any]:
    """Read the figures written by `evaluate_run`. Raises RunError for a damaged, edited or foreign file."""
    try:
        return read_formed(path, FORM)
    except (OSError, ValueError) as error:
        raise RunError(f"{path}: {error}; delete it, and the run is evaluated again") from None
