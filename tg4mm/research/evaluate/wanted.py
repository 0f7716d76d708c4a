"""The request of an evaluation, checked before anything is loaded, and its figures as a table."""

import math
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tg4mm.capture import Capture, load_capture
from tg4mm.capture.dataset_tree import magnified_alphas
from tg4mm.core.errors import CaptureError
from tg4mm.core.metrics import NO_FLIP, SSIM_WINDOW, flip, has_flip, psnr, ssim
from tg4mm.core.untrusted import read_json
from tg4mm.research.evaluate import EvaluationError
from tg4mm.research.evaluate.lpips import MIN_SIZE, load_lpips
from tg4mm.research.evaluate.scores import Metric
from tg4mm.research.text import shown, table
from tg4mm.run import Run
from tg4mm.run.log import FORMAT


def target_file(run: Run, out: Path | str | None) -> Path:
    """The file for the figures, its folder made: one that cannot be is better known before minutes of scoring."""
    target = Path(out) if out is not None else run.path / "metrics.json"
    if target.is_dir():
        raise EvaluationError(
            f"--out {target}: is a folder; expected a file such as {target / 'metrics.json'}"
        )
    if target.exists() and not _is_ours(target):
        raise EvaluationError(f"--out {target}: exists, and is no {FORMAT} file; choose another name")
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        tempfile.TemporaryFile(dir=target.parent).close()
    except OSError as error:
        raise EvaluationError(f"--out {target}: cannot be written: {error.strerror}") from None
    return target


def _is_ours(target: Path) -> bool:
    try:
        found = read_json(target)
    except (OSError, ValueError):
        return False
    return isinstance(found, dict) and found.get("format") == FORMAT


def alphas_with_truth(alphas: Sequence[float] | None, root: Path, absent: dict[str, str]) -> list[int]:
    """0 and the whole α that have ground truth; the others go to `absent`."""
    for alpha in alphas or ():
        if not (math.isfinite(alpha) and alpha >= 0):
            raise EvaluationError(f"--alphas holds {alpha}, expected numbers ≥ 0")
    found = magnified_alphas(root)
    if alphas is None and not found:
        absent["magnified images"] = f"{root / 'magnified'} has no x… folder: no ground truth beyond α = 0"
    for alpha in alphas or ():
        if alpha not in found and alpha != 0:
            there = ", ".join(map(str, found)) or "none"
            absent[f"α = {alpha:g}"] = f"no such ground truth under {root / 'magnified'} (there: {there})"
    return [0, *(a for a in found if alphas is None or a in alphas)]


def check_alphas(alphas: Sequence[float] | None, root: Path) -> list[int]:
    """The α that are scored. Raises EvaluationError for one that is asked for and has no ground truth."""
    absent: dict[str, str] = {}
    found = alphas_with_truth(alphas, root, absent)
    if alphas is not None and absent:
        what, why = next(iter(absent.items()))
        raise EvaluationError(f"--alphas holds {what}: {why}")
    return found


def image_metrics(
    lpips_weights: Path | str | Sequence[Path | str] | None,
    absent: dict[str, str],
    names: Sequence[str] | None = None,
) -> dict[str, Metric]:
    """The metrics `names`, None for all. LPIPS without weights goes to `absent`. Raises EvaluationError for others."""
    found: dict[str, Metric] = {"psnr_db": psnr, "ssim": ssim, "flip": flip}
    for name in names or ():
        if name not in {*found, "lpips"}:
            raise EvaluationError(f"metrics hold {name!r}, expected some of {', '.join(found)}, lpips")
    wanted = {*found, "lpips"} if names is None else set(names)
    if "flip" in wanted and not has_flip():
        if names is not None:
            raise EvaluationError(f"metric flip: {NO_FLIP}")
        absent["FLIP"] = NO_FLIP
        del found["flip"]
    if "lpips" in wanted and lpips_weights is None:
        absent["LPIPS"] = "no weights given (AlexNet's trunk and LPIPS' heads, as local files)"
    elif "lpips" in wanted and lpips_weights is not None:
        found["lpips"] = load_lpips(lpips_weights)
    return {name: metric for name, metric in found.items() if name in wanted}


def capture_with_truth(root: Path, alpha: int, absent: dict[str, str]) -> Capture | None:
    if alpha:
        capture = load_capture(root, split="test", magnification=alpha)
        there = len(set(capture.timesteps.tolist()))
        if there < capture.n_timesteps:
            absent[f"α = {alpha}, part of it"] = (
                f"{capture.n_timesteps - there} of {capture.n_timesteps} timesteps"
            )
        return capture
    try:
        return load_capture(root, split="test")
    except CaptureError as error:
        # Absent is said; present and broken is an error.
        if any(root.glob("transforms_test.json")) or any(root.glob("*/transforms_test.json")):
            raise
        absent["α = 0"] = f"no test split ({error})"
        return None


def fitting(metrics: Mapping[str, Metric], capture: Capture, absent: dict[str, str]) -> dict[str, Metric]:
    """The metrics that images of this size allow."""
    least = {"ssim": SSIM_WINDOW, "lpips": MIN_SIZE}
    small = {m for m in metrics if min(capture.width, capture.height) < least.get(m, 1)}
    for name in small:
        absent[name.upper()] = f"images of {capture.width}×{capture.height} pixels, it needs {least[name]}²"
    return {m: f for m, f in metrics.items() if m not in small}


COLUMNS = (("psnr_db", "PSNR dB ↑", "{:.2f}"), ("ssim", "SSIM ↑", "{:.4f}"), ("flip", "FLIP ↓", "{:.4f}"))
LPIPS_COLUMN = ("lpips", "LPIPS ↓", "{:.4f}")


def format_table(metrics: dict[str, Any]) -> str:
    """Markdown of what `evaluate_run` returns: a row per α and method, displacement, what is absent."""
    columns = [*COLUMNS, *([LPIPS_COLUMN] if "lpips" in metrics["metrics"] else [])]
    rows = [["α", "method", *(title for _, title, _ in columns), "displacement error"]]
    for entry in metrics["alphas"]:
        for name, row in entry["rows"].items():
            values = [shown(row.get(key), form) for key, _, form in columns]
            error = (metrics["displacement_error"] or {}).get(name)
            rows.append([f"{entry['alpha']:g}", name, *values, shown(error, "{:.3f}")])
    lines = [table(rows[0], rows[1:], 1, 1)] if len(rows) > 1 else ["No images to score."]
    lines += _changes(metrics["alphas"])
    return "\n".join([*lines, *_displacement(metrics["displacement"]), *_remarks(metrics)]) + "\n"


def _changes(entries: list[dict[str, Any]]) -> list[str]:
    """A line for each α with a ceiling: how much of what the exact motion would show is shown."""
    return [
        f"α = {entry['alpha']:g}: closure {shown(entry['closure'], '{:.2f}')} (SSIM, nothing moves 0, ceiling 1); "
        f"the picture's change is {shown(entry['change_gain'], '{:.2f}')} of the ceiling's, "
        f"{shown(entry['change_residual'], '{:.2f}')} beside it"
        for entry in entries
        if entry["closure"] is not None
    ]


def _displacement(figures: dict[str, Any] | None) -> list[str]:
    if figures is None:
        return []
    error = shown(figures["relative_error"], "{:.3f}")
    lines = ["", f"Displacement error {error} (rms/rms, weighted by what is seen)"]
    leak = figures["static_leak"]
    if leak is not None:
        lines.append(
            f"Static leak {leak:.4f} (rms of motion given to what stands still / rms of true motion)"
        )
    if sure := figures.get("uncertainty"):
        lines.append(
            f"Uncertainty {sure['said']:.2g} units rms as the run says it, {sure['error']:.2g} by the truth; "
            f"{100 * sure['within_two']:.0f} % of what is seen is off by at most twice what is said"
        )
    for row in figures["per_frequency"]:
        estimated, true = (_length(row, f"amplitude_{which}") for which in ("estimated", "true"))
        ratio = shown(row["amplitude_ratio"], "{:.3f}")
        direction, phase = (shown(row[f"{what}_error_deg"], "{:.2f}°") for what in ("direction", "phase"))
        lines.append(
            f"{row['frequency_hz']:g} Hz: amplitude {estimated}, true {true} (ratio {ratio}), "
            f"direction off by {direction}, phase by {phase}"
        )
    return lines


def _length(row: dict[str, Any], key: str) -> str:
    in_mm = f" ({row[f'{key}_mm']:.4g} mm)" if row.get(f"{key}_mm") is not None else ""
    return f"{shown(row[key], '{:.4g}')} units{in_mm}"


def _remarks(metrics: dict[str, Any]) -> list[str]:
    absent = [f"Not measured: {what}: {why}" for what, why in metrics["absent"].items()]
    return ["", *absent, *metrics["notes"]] if absent or metrics["notes"] else []
