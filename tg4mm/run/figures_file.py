"""metrics.json read back: of the form that `evaluate_run` writes, or refused."""

from pathlib import Path
from typing import Any

from tg4mm.core.errors import RunError
from tg4mm.core.records import read_formed
from tg4mm.core.values import Just, Maybe

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


def read_figures(path: Path) -> dict[str, Any]:
    """What `evaluate_run` wrote. Raises RunError for a file that is damaged, edited, or of another kind."""
    try:
        return read_formed(path, FORM)
    except (OSError, ValueError) as error:
        raise RunError(f"{path}: {error}; delete it, and the run is evaluated again") from None
