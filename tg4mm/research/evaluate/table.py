"""The metrics of a run as a Markdown table that also reads well as plain text."""

from __future__ import annotations

from typing import Any

from tg4mm.research.text import shown, table

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
