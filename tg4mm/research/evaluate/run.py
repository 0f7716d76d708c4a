"""Evaluation of a trained run against ground truth, beside the two rows that give its figures meaning."""

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture import load_capture, load_images
from tg4mm.core.files import json_digest, write_json
from tg4mm.core.filters import TemporalFilter
from tg4mm.core.magnification import AS_CAPTURED, Magnification
from tg4mm.core.progress import progress
from tg4mm.research.evaluate.scores import (
    BACKGROUND,
    Key,
    Scorer,
    change_figures,
    closure,
)
from tg4mm.research.evaluate.subject import (
    CEILING,
    OURS,
    STATIC,
    Subject,
    displacement_of,
    notes_of,
    subject_of,
)
from tg4mm.research.evaluate.wanted import (
    alphas_with_truth,
    capture_with_truth,
    fitting,
    image_metrics,
    target_file,
)
from tg4mm.run import Run
from tg4mm.run.log import FORMAT
from tg4mm.run.poses import method_of

VERSION = 1
_HIGHER_IS_BETTER = {"psnr_db": True, "ssim": True, "flip": False, "lpips": False}


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
