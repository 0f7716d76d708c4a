"""Evaluation of a trained run against ground truth, beside the two rows that give its figures meaning."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture import Capture, load_capture, load_images
from tg4mm.errors import CaptureError
from tg4mm.evaluate.displacement import displacement_figures
from tg4mm.evaluate.errors import EvaluationError
from tg4mm.evaluate.lpips import MIN_SIZE, load_lpips
from tg4mm.evaluate.metrics import SSIM_WINDOW, flip, psnr, ssim
from tg4mm.evaluate.resume import Resume, fingerprint
from tg4mm.evaluate.scores import BACKGROUND, Method, Metric, Posing, Scorer, in_bands
from tg4mm.evaluate.truth import TRUTH_FILE, exact_motion, load_truth
from tg4mm.evaluate.weights import blending_weights
from tg4mm.files import write_json
from tg4mm.gaussians import Gaussians
from tg4mm.magnify import BandGain, Magnification, TemporalFilter
from tg4mm.magnify.bands import check_bands
from tg4mm.magnify.poses import method_of, poses_of
from tg4mm.motion.modal import ModalMotion
from tg4mm.progress import progress
from tg4mm.runs import Run, model_hash

FORMAT, VERSION = "tg4mm-metrics", 1
STATIC, OURS, CEILING = "nothing moves", "ours", "ceiling"
_HIGHER_IS_BETTER = {"psnr_db": True, "ssim": True, "flip": False, "lpips": False}


@dataclass(frozen=True)
class _Subject:
    """What is evaluated: the Gaussians of a run, their estimated and their exact motion."""

    gaussians: Gaussians
    estimated: ModalMotion | None
    exact: ModalMotion | None
    bands: tuple[tuple[float, float], ...]
    posing: Posing | None  # None: modal, by the estimated motion and at most one band

    @property
    def methods(self) -> list[Method]:
        found = [Method(STATIC, None)]
        if self.estimated is not None and self.posing is not None:
            found.append(Method(OURS, self.estimated, posing=self.posing))
        elif self.estimated is not None:
            found.append(Method(OURS, self.estimated, self.bands[0] if self.bands else None))
        if self.exact is not None:
            found.append(Method(CEILING, self.exact))
        return found


def evaluate_run(
    run: Run,
    alphas: Sequence[float] | None = None,
    out: Path | str | None = None,
    band: Sequence[float] | None = None,
    lpips_weights: Path | str | Sequence[Path | str] | None = None,
    device: str = "cpu",
    use_cache: bool = True,
    bands: Sequence[tuple[float, float]] = (),
    method: str | None = None,
    filter: TemporalFilter | None = None,
) -> dict[str, Any]:
    """Score a run on its dataset's test cameras and write the figures to `out` (default RUN/metrics.json).

    `alphas`: magnification factors with ground truth, None for all there are; 0, the test split itself, is
    always scored. `band` (Hz): what "ours" magnifies, None for all frequencies; ground truth magnifies all. `bands`:
    several in its place, all by the same α. `method`, `filter`: as in `tg4mm.magnify.Magnification`.
    `device`: where pictures are rendered; metrics are computed on the CPU, so each picture is brought there once.
    `lpips_weights`: see `tg4mm.evaluate.lpips`. `use_cache=False` scores every image anew (same numbers,
    slower).

    What is absent (a split, an α, truth/, LPIPS weights) is named under `absent`; what is there but broken
    raises a Tg4mmError. A killed evaluation goes on at the first α that was not finished.

    Methods: "nothing moves" (the Gaussians at rest), "ours" (the run's motion), "ceiling" (the exact motion
    applied to the same Gaussians). Renderings are not rounded to 8 bits. Returned and written:

        format, version            "tg4mm-metrics", 1
        run, dataset               folders
        band_hz, background        null | [low, high], with several a list of them; [1, 1, 1]
        method, filter             "modal" | "linear" | "phase"; null | "zero-phase" | "ideal" | "published"
        metrics                    names of the image metrics that were measured
        alphas                     [{alpha, n_images, rows, gap_to_ceiling}], per α:
          rows                       {method: {psnr_db, ssim, flip, lpips}}, image means, null: not measured
          gap_to_ceiling             {same keys} | null: how much worse "ours" is than the ceiling
        displacement_error         {method: rms/rms} | null; by definition "nothing moves" 1, the ceiling 0
        displacement               `displacement_figures` of "ours" | null; given a band, `in_band` holds the
                                   same of the modes inside it
        absent                     {what: why}
        notes                      [text]
        seconds                    of this call
    """
    began = time.monotonic()
    absent: dict[str, str] = {}
    wanted = _alphas(alphas, run.dataset, absent)
    bands = tuple(bands) or (() if band is None else (tuple(band),))  # type: ignore[assignment]
    plan = Magnification(method=method, filter=filter)
    metrics = _metrics(lpips_weights, absent)
    capture = load_capture(run.dataset, split="train")
    subject = _subject(run, capture, bands, plan, absent, device)
    target = _target(run, out)
    scorer = Scorer(subject.gaussians, metrics, use_cache)
    resume = Resume(target)
    entries = [
        e for a in wanted if (e := _score_alpha(run.dataset, a, subject, scorer, resume, absent)) is not None
    ]
    figures = _displacement(subject, capture, absent)
    result = {
        "format": FORMAT,
        "version": VERSION,
        "run": str(run.path),
        "dataset": str(run.dataset),
        "band_hz": _plain_bands(subject.bands),
        "method": method_of(run, plan),
        "filter": _filter_name(run, plan),
        "background": list(BACKGROUND),
        "metrics": [m for m in _HIGHER_IS_BETTER if any(_measured(e, m) for e in entries)],
        "alphas": entries,
        "displacement_error": figures and {STATIC: 1.0, OURS: figures["relative_error"], CEILING: 0.0},
        "displacement": figures,
        "absent": absent,
        "notes": _notes(subject),
        "seconds": round(time.monotonic() - began, 3),
    }
    write_json(target, result)
    resume.drop()
    return result


def _target(run: Run, out: Path | str | None) -> Path:
    """The file for the figures, its folder made: one that cannot be is better known before minutes of scoring."""
    target = Path(out) if out is not None else run.path / "metrics.json"
    if target.is_dir():
        raise EvaluationError(
            f"--out {target}: is a folder; expected a file such as {target / 'metrics.json'}"
        )
    target.parent.mkdir(parents=True, exist_ok=True)
    return target


def _alphas(alphas: Sequence[float] | None, root: Path, absent: dict[str, str]) -> list[int]:
    """0 and the whole α that have ground truth; the others go to `absent`."""
    for alpha in alphas or ():
        if not (math.isfinite(alpha) and alpha >= 0):
            raise EvaluationError(f"--alphas holds {alpha}, expected numbers ≥ 0")
    folders = [p.name for p in (root / "magnified").glob("x*") if p.is_dir()]
    found = {int(n[1:]) for n in folders if n[1:].isdecimal() and n == f"x{int(n[1:]):03d}"}
    if alphas is None and not found:
        absent["magnified images"] = f"{root / 'magnified'} has no x… folder: no ground truth beyond α = 0"
    for alpha in alphas or ():
        if alpha not in found and alpha != 0:
            there = ", ".join(str(a) for a in sorted(found)) or "none"
            absent[f"α = {alpha:g}"] = f"no such ground truth under {root / 'magnified'} (there: {there})"
    return [0, *sorted(a for a in found if a > 0 and (alphas is None or a in alphas))]


def _metrics(
    lpips_weights: Path | str | Sequence[Path | str] | None, absent: dict[str, str]
) -> dict[str, Metric]:
    metrics: dict[str, Metric] = {"psnr_db": psnr, "ssim": ssim, "flip": flip}
    if lpips_weights is None:
        absent["LPIPS"] = "no weights given (AlexNet's trunk and LPIPS' heads, as local files)"
    else:
        metrics["lpips"] = load_lpips(lpips_weights)
    return metrics


def _subject(
    run: Run,
    capture: Capture,
    bands: Sequence[tuple[float, float]],
    plan: Magnification,
    absent: dict[str, str],
    device: str,
) -> _Subject:
    gaussians = run.load_space()
    estimated = run.load_motion()
    if estimated is None:
        absent["ours"] = (
            f"{run.path} has no motion: its motion stage is not finished, or the capture is one timestep"
        )
    elif (estimated.fps, estimated.n_timesteps) != (capture.fps, capture.n_timesteps):
        raise EvaluationError(
            f"{run.path} was trained on {estimated.n_timesteps} timesteps at {estimated.fps:g} Hz, "
            f"but {run.dataset} holds {capture.n_timesteps} at {capture.fps:g} Hz"
        )
    exact = None
    if (run.dataset / TRUTH_FILE).is_file() and capture.n_timesteps > 1:
        truth = load_truth(run.dataset, capture.fps, capture.n_timesteps)
        exact = exact_motion(truth, gaussians.means.numpy())
    else:
        absent["ceiling"] = (
            f"{run.dataset / TRUTH_FILE} does not exist: no exact motion, no displacement error"
        )
    check_bands(bands, capture.fps)
    posing = None if estimated is None else _posing(run, bands, plan, device)
    return _Subject(gaussians.to(device), estimated, exact, tuple(bands), posing)


def _posing(
    run: Run, bands: Sequence[tuple[float, float]], plan: Magnification, device: str
) -> Posing | None:
    """How the run poses and magnifies, None where its motion and one band say it all."""
    if method_of(run, plan) == "modal" and len(bands) <= 1:
        return None

    @lru_cache(maxsize=1)
    def at(alpha: float) -> Callable[[float], Gaussians]:
        gains = tuple(BandGain(*band, alpha) for band in bands)
        everywhere = 0.0 if bands else alpha
        return poses_of(run, replace(plan, bands=gains, everywhere=everywhere), device).at

    return Posing(at, repr((method_of(run, plan), plan, list(bands), model_hash(run.path))))


def _plain_bands(bands: Sequence[tuple[float, float]]) -> list[Any] | None:
    listed = [list(band) for band in bands]
    return listed[0] if len(listed) == 1 else listed or None


def _filter_name(run: Run, plan: Magnification) -> str | None:
    return None if method_of(run, plan) == "modal" else (plan.filter or TemporalFilter()).kind


def _score_alpha(
    root: Path, alpha: int, subject: _Subject, scorer: Scorer, resume: Resume, absent: dict[str, str]
) -> dict[str, Any] | None:
    capture = _test_capture(root, alpha, absent)
    if capture is None:
        return None
    images = load_images(capture)
    scorer = replace(scorer, metrics=_fitting(scorer.metrics, capture, absent))
    key = fingerprint(scorer, subject.methods, capture, images, alpha)
    if (kept := resume.get(key)) is not None:
        return kept
    methods = subject.methods
    with progress(f"evaluate α = {alpha}", len(images) * len(methods), unit="images") as update:
        scores = scorer.score(methods, capture, images, float(alpha), update)
    rows = {name: _means(values) for name, values in scores.items()}
    gap = _gap(rows[OURS], rows[CEILING]) if OURS in rows and CEILING in rows else None
    entry = {"alpha": alpha, "n_images": len(images), "rows": rows, "gap_to_ceiling": gap}
    resume.put(key, entry)
    return entry


def _test_capture(root: Path, alpha: int, absent: dict[str, str]) -> Capture | None:
    if alpha:
        return load_capture(root, split="test", magnification=alpha)
    try:
        return load_capture(root, split="test")
    except CaptureError as error:
        # Absent is said; present and broken is an error.
        if any(root.glob("transforms_test.json")) or any(root.glob("*/transforms_test.json")):
            raise
        absent["α = 0"] = f"no test split ({error})"
        return None


def _fitting(metrics: Mapping[str, Metric], capture: Capture, absent: dict[str, str]) -> dict[str, Metric]:
    """The metrics that images of this size allow."""
    least = {"ssim": SSIM_WINDOW, "lpips": MIN_SIZE}
    small = {m for m in metrics if min(capture.width, capture.height) < least.get(m, 1)}
    for name in small:
        absent[name.upper()] = f"images of {capture.width}×{capture.height} pixels, it needs {least[name]}²"
    return {m: f for m, f in metrics.items() if m not in small}


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


def _displacement(subject: _Subject, capture: Capture, absent: dict[str, str]) -> dict[str, Any] | None:
    """`displacement_figures` of the run's motion, also of the part in the band, if both motions are there."""
    estimated, exact = subject.estimated, subject.exact
    if estimated is None or exact is None:
        return None
    weights = blending_weights(subject.gaussians, capture)
    if not weights.sum() > 0:
        absent["displacement error"] = "no training camera sees any Gaussian"
        return None
    figures = displacement_figures(estimated, exact, weights, capture.unit_scale_m)
    if subject.bands:
        inside = [m.selected(in_bands(m.freqs_hz, subject.bands)) for m in (estimated, exact)]
        figures["in_band"] = displacement_figures(inside[0], inside[1], weights, capture.unit_scale_m)
    return figures


def _notes(subject: _Subject) -> list[str]:
    """What "ours" magnifies and the ground truth does not, or the other way round."""
    exact, bands = subject.exact, subject.bands
    if exact is None:
        return []
    moving, magnified = exact.displacement.any(axis=(1, 2)), exact.is_magnified()
    inside = in_bands(exact.freqs_hz, bands)
    notes = []
    if bands and (outside := exact.freqs_hz[moving & magnified & ~inside]).size:
        notes.append(
            f"The ground truth also magnifies motion at {_hertz(outside)}, "
            f"outside the band {' and '.join(f'{low:g} to {high:g}' for low, high in bands)} Hz."
        )
    if (left := exact.freqs_hz[moving & ~magnified & inside]).size:
        where = "without a band, ours does" if not bands else "which lies inside the band"
        notes.append(f"The ground truth does not magnify motion at {_hertz(left)}, {where}.")
    return notes


def _hertz(frequencies: np.ndarray) -> str:
    return ", ".join(f"{f:g}" for f in frequencies) + " Hz"
