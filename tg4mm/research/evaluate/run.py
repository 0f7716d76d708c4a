"""Evaluates a trained run against ground truth, with two rows for comparison."""

import math
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture import Capture, load_capture, load_images
from tg4mm.capture.dataset_tree import magnified_alphas
from tg4mm.core.errors import CaptureError
from tg4mm.core.files import json_digest, write_json
from tg4mm.core.magnification import AS_CAPTURED, Magnification, TemporalFilter
from tg4mm.core.metrics import NO_FLIP, SSIM_WINDOW, flip, has_flip, psnr, ssim
from tg4mm.core.progress import progress
from tg4mm.core.untrusted import read_json
from tg4mm.research.evaluate import EvaluationError
from tg4mm.research.evaluate.lpips import MIN_SIZE, load_lpips
from tg4mm.research.evaluate.scores import (
    BACKGROUND,
    CEILING,
    OURS,
    STATIC,
    Key,
    Metric,
    Scorer,
    Subject,
    change_figures,
    closure,
    displacement_of,
    notes_of,
    subject_of,
)
from tg4mm.research.text import shown, table
from tg4mm.run import Run
from tg4mm.run.log import FORMAT
from tg4mm.run.preset import method_of

COLUMNS = (("psnr_db", "PSNR dB ↑", "{:.2f}"), ("ssim", "SSIM ↑", "{:.4f}"), ("flip", "FLIP ↓", "{:.4f}"))
LPIPS_COLUMN = ("lpips", "LPIPS ↓", "{:.4f}")
VERSION = 1
_HIGHER_IS_BETTER = {"psnr_db": True, "ssim": True, "flip": False, "lpips": False}


def target_file(run: Run, out: Path | str | None) -> Path:
    """Return the file of the figures, and make its folder, so that errors appear before minutes of scoring."""
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
    """Return 0 and the integer α with ground truth; the others go to `absent`."""
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
    """Return the scored α. Raises EvaluationError for a requested one without ground truth."""
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
    """Return the metrics `names`, or all. LPIPS without weights goes to `absent`. Raises EvaluationError for others."""
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
    """Return the test capture with its ground truth at α; None, noted in `absent`, without a test split."""
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
        # An absent split is noted, a broken one is an error.
        if any(root.glob("transforms_test.json")) or any(root.glob("*/transforms_test.json")):
            raise
        absent["α = 0"] = f"no test split ({error})"
        return None


def fitting(metrics: Mapping[str, Metric], capture: Capture, absent: dict[str, str]) -> dict[str, Metric]:
    """Return the metrics that images of this size allow."""
    least = {"ssim": SSIM_WINDOW, "lpips": MIN_SIZE}
    small = {m for m in metrics if min(capture.width, capture.height) < least.get(m, 1)}
    for name in small:
        absent[name.upper()] = f"images of {capture.width}×{capture.height} pixels, it needs {least[name]}²"
    return {m: f for m, f in metrics.items() if m not in small}


def format_table(metrics: dict[str, Any]) -> str:
    """Return the figures of `evaluate_run` as Markdown: a row per α and method, displacement, absent parts."""
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
    """Return a line for each α with a ceiling: the shown share of the exact motion's change."""
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
    lines = ["", f"Displacement error {error} (rms/rms, weighted by visibility)"]
    leak = figures["static_leak"]
    if leak is not None:
        lines.append(f"Static leak {leak:.4f} (rms of estimated motion of static parts / rms of true motion)")
    if sure := figures.get("uncertainty"):
        lines.append(
            f"Uncertainty {sure['said']:.2g} units rms as the run states it, {sure['error']:.2g} by the truth; "
            f"{100 * sure['within_two']:.0f} % of the visible scene has at most twice the stated error"
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


def evaluate_run(
    run: Run,
    alphas: Sequence[float] | None = None,
    out: Path | str | None = None,
    magnified: Magnification = AS_CAPTURED,
    lpips_weights: Path | str | Sequence[Path | str] | None = None,
    device: str = "cpu",
    use_cache: bool = True,
    scores: dict[Key, dict[str, float]] | None = None,
    metrics: Sequence[str] | None = None,
) -> dict[str, Any]:
    """Score a run on its dataset's test cameras and write the figures to `out` (default RUN/metrics.json).

    `alphas`: magnification factors with ground truth, None for all there are; 0, the test split itself, is
    always scored. `magnified`: bands, method and filter of "ours"; its α are replaced by each of `alphas`. Ground truth
    magnifies all frequencies.
    `device`: where pictures are rendered; metrics are computed on the CPU, so each picture is brought there once.
    `lpips_weights`: see `tg4mm.research.evaluate.lpips`. `use_cache=False` scores every image anew (same numbers,
    slower). `scores`: what another call for the same run has scored is taken from there, and left there; not with other
    `lpips_weights` or `metrics`. `metrics`: some of psnr_db, ssim, flip, lpips; None for all of them.

    What is absent (a split, an α, truth/, LPIPS weights) is named under `absent`; what is there but broken
    raises a Tg4mmError.

    Methods: "nothing moves" (the Gaussians at rest), "ours" (the run's motion), "ceiling" (the exact motion
    applied to the same Gaussians). Renderings are not rounded to 8 bits. Returned and written:

        format, version            "tg4mm-metrics", 1
        run, dataset               folders
        band_hz, background        null | [low, high], with several a list of them; [1, 1, 1]
        method, filter             "modal" | "linear" | "phase"; null | "zero-phase" | "ideal" | "published"
        metrics                    names of the image metrics that were measured
        alphas                     [{alpha, n_images, rows, gap_to_ceiling, closure, …}], per α:
          rows                       {method: {psnr_db, ssim, flip, lpips}}, image means, null: not measured
          gap_to_ceiling             {same keys} | null: how much worse "ours" is than the ceiling
          closure                    SSIM of "ours" from "nothing moves" (0) to the ceiling (1) | null
          change_gain                of the picture's change on the ceiling's, `change_figures` | null
          change_residual            what of the change is not the ceiling's, relative to it | null
        displacement_error         {method: rms/rms} | null; by definition "nothing moves" 1, the ceiling 0
        displacement               `displacement_figures` of "ours" | null; given a band, `in_band` holds the
                                   same of the modes inside it; `uncertainty`: `uncertainty_figures`, where
                                   the run says how sure it is
        absent                     {what: why}
        notes                      [text]
        seconds                    of this call
        digest                     of all the other entries, `tg4mm.core.files.json_digest`
    """
    began = time.monotonic()
    absent: dict[str, str] = {}
    wanted = alphas_with_truth(alphas, run.dataset, absent)
    chosen = image_metrics(lpips_weights, absent, metrics)
    capture = load_capture(run.dataset, split="train")
    with progress("motion and its truth", 1, "part", brief=True):
        subject = subject_of(run, capture, magnified, absent, device)
    target = target_file(run, out)
    scorer = Scorer(subject.gaussians, chosen, use_cache, {} if scores is None else scores)
    entries = [e for a in wanted if (e := _score_alpha(run.dataset, a, subject, scorer, absent)) is not None]
    figures = displacement_of(subject, capture, absent)
    result = {
        "format": FORMAT,
        "version": VERSION,
        "run": str(run.path),
        "dataset": str(run.dataset),
        "band_hz": _plain_bands(magnified),
        "method": method_of(run, magnified),
        "filter": _filter_name(run, magnified),
        "background": list(BACKGROUND),
        "metrics": [m for m in _HIGHER_IS_BETTER if any(_measured(e, m) for e in entries)],
        "alphas": entries,
        "displacement_error": figures and {STATIC: 1.0, OURS: figures["relative_error"], CEILING: 0.0},
        "displacement": figures,
        "absent": absent,
        "notes": notes_of(subject),
        "seconds": round(time.monotonic() - began, 3),
    }
    result["digest"] = json_digest(result)
    write_json(target, result)
    return result


def _plain_bands(magnified: Magnification) -> list[Any] | None:
    listed = [list(band) for band in magnified.limits]
    return listed[0] if len(listed) == 1 else listed or None


def _filter_name(run: Run, magnified: Magnification) -> str | None:
    return None if method_of(run, magnified) == "modal" else (magnified.filter or TemporalFilter()).kind


def _score_alpha(
    root: Path, alpha: int, subject: Subject, scorer: Scorer, absent: dict[str, str]
) -> dict[str, Any] | None:
    capture = capture_with_truth(root, alpha, absent)
    if capture is None:
        return None
    images = load_images(capture)
    scorer = replace(scorer, metrics=fitting(scorer.metrics, capture, absent))
    methods = subject.methods
    with progress(f"evaluate α = {alpha}", len(images) * len(methods), unit="images") as update:
        scores = scorer.score(methods, capture, images, float(alpha), update)
    rows = {name: _means(values) for name, values in scores.items()}
    entry = {"alpha": alpha, "n_images": len(images), "rows": rows, **_against_ceiling(rows)}
    changes: dict[str, float | None] = {"change_gain": None, "change_residual": None}
    if OURS in rows and CEILING in rows:
        named = {m.name: m for m in methods}
        with progress(f"change of the pictures α = {alpha}", len(images), unit="images") as update:
            moved = scorer.gaussians, named[OURS], named[CEILING], capture, float(alpha), update
            changes = change_figures(*moved)
    entry |= changes
    return entry


def _against_ceiling(rows: dict[str, dict[str, float | None]]) -> dict[str, Any]:
    if OURS not in rows or CEILING not in rows:
        return {"gap_to_ceiling": None, "closure": None}
    ssim = [rows[name]["ssim"] for name in (OURS, STATIC, CEILING)]
    known = [value for value in ssim if value is not None]
    return {
        "gap_to_ceiling": _gap(rows[OURS], rows[CEILING]),
        "closure": closure(*known) if len(known) == 3 else None,
    }


def _means(values: list[dict[str, float]]) -> dict[str, float | None]:
    return {m: float(np.mean([v[m] for v in values])) if m in values[0] else None for m in _HIGHER_IS_BETTER}


def _gap(ours: dict[str, float | None], ceiling: dict[str, float | None]) -> dict[str, float | None]:
    gap: dict[str, float | None] = {}
    for name, higher_is_better in _HIGHER_IS_BETTER.items():
        a, b = ours[name], ceiling[name]
        gap[name] = None if a is None or b is None else (b - a if higher_is_better else a - b)
    return gap


def _measured(entry: dict[str, Any], metric: str) -> bool:
    return any(row[metric] is not None for row in entry["rows"].values())
