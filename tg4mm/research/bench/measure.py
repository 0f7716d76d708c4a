"""One run of a benchmark: trains, scores by every requested method and keeps the figures; nothing is done twice."""

import dataclasses
import gc
import shutil
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture import Capture, load_capture, load_images
from tg4mm.core.errors import RunError
from tg4mm.core.magnification import AS_CAPTURED
from tg4mm.core.metrics import NO_FLIP, has_flip
from tg4mm.core.untrusted import read_formed, write_sealed
from tg4mm.core.values import Just, Maybe
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.research.bench.folder import CIRCUMSTANCES, circumstances, files_state, safe_name
from tg4mm.research.bench.request import BenchPlan, Scoring, Training
from tg4mm.research.bench.sets import BenchSet, check_alphas, truth_state
from tg4mm.research.evaluate.displacement import displacement_figures
from tg4mm.research.evaluate.lpips import load_lpips
from tg4mm.research.evaluate.run import CEILING, OURS, STATIC, evaluate_run
from tg4mm.research.evaluate.scores import BACKGROUND, Key, ScoredMotion, Subject, render_views, subject_of
from tg4mm.research.paper.model import disk_mib
from tg4mm.run import Run
from tg4mm.run.log import DISPLACEMENT
from tg4mm.run.tensor_file import model_hash
from tg4mm.run.train import parse_settings, train
from tg4mm.show.maps import blending_weights, pixel_sums

AGREES = 0.5  # correlation of both changes from which a Gaussian's motion counts as observed
_SHIFT_PX = 1.0  # intended motion by the choice of α, large enough to show and small enough to be linear
_TIMES = 12  # timesteps that are compared, at most
_STILL = 0.01  # of the largest motion; a Gaussian with less is static
FIGURES = "figures.json"
MADE = "made.json"
SEEN = ("closure", "change_gain", "change_residual")  # visible motion by one way to magnify
VERSION = 5  # of the figures; to be raised when the same request would give others
_STAGES = {"space": float, "motion": float, "total": float}
# Entries of a run for tables and pages, here and in results.json.
OF_RUN = {
    "log": {str: dict.fromkeys(("seconds?", "peak_memory_mib?", "iterations?"), Maybe(float))},
    "seconds": _STAGES,
    "model": str,
    "rows": {float: {str: {str: Maybe(float)}}},
    "displacement": Maybe(DISPLACEMENT),
    "notes": [str],
    "made?": CIRCUMSTANCES,  # time, machine and version of the training
}
FORM = {
    "version": Just(VERSION),
    "request": {"settings": {str: dict}, "band_hz": Maybe([float])},
    **OF_RUN,
    "n_gaussians": int,
    "mib_on_disk": float,
    "absent": {str: str},
    "observed?": {str: Maybe(float)},
    "strongest_hz?": Maybe(float),
}


def observed_figures(subject: Subject, data: BenchSet, train: Capture) -> dict[str, float | None]:
    """Return the displacement error over observable and static Gaussians, and the observed share of the moving weight.

    Figures are None without an exact or estimated motion.
    """
    names = ("displacement_error_observed", "observed_share")
    if subject.estimated is None or subject.exact is None:
        return dict.fromkeys(names)
    weights = blending_weights(subject.gaussians, train)
    agrees = agreement(subject.gaussians, subject.exact, data)
    size = rms_motion(subject.exact)
    still = size <= _STILL * size.max(initial=0.0)
    observed = agrees >= AGREES
    moving = weights * ~still
    share = float((moving * observed).sum() / moving.sum()) if moving.sum() > 0 else None
    kept = weights * (observed | still)
    if share is None or not kept.sum() > 0:
        return dict.fromkeys(names)
    estimated = subject.estimated
    if subject.from_zero:
        estimated = estimated.selected(estimated.freqs_hz > 0)
    figures = displacement_figures(estimated, subject.exact, kept)
    return dict(zip(names, (figures["relative_error"], share), strict=True))


def agreement(gaussians: Gaussians, exact: ModalMotion, data: BenchSet) -> np.ndarray:
    """Correlate each Gaussian's exact change with the ground truth's over its pixels, [N]; 0 without a change.

    Pictures are those of the test cameras, at the α that brings the motion nearest to one pixel.
    """
    alpha = min(data.alphas, key=lambda a: abs(np.log((1 + a) * data.amplitude_px / _SHIFT_PX)))
    capture = load_capture(data.root, split="test", magnification=alpha)
    images, moved = load_images(capture), ScoredMotion("exact", exact)
    times = looked_at(capture.n_timesteps, data.fps, data.frequency_hz)
    sums = np.zeros((len(gaussians), 3))  # made · made, made · true, true · true
    for camera in np.unique(capture.camera_ids).tolist():
        rows = np.flatnonzero(capture.camera_ids == camera)
        chosen = [int(i) for i in rows if capture.timesteps[i] in times]
        true = np.stack([images.rgb(i, background=BACKGROUND) for i in chosen])
        posed = ((i, moved.pose(gaussians, int(capture.timesteps[i]), alpha)) for i in chosen)
        made = np.concatenate([render_views(g, capture, np.array([i])) for i, g in posed])
        true, made = true - true.mean(0), made - made.mean(0)
        maps = np.stack([(made * made).sum((0, 3)), (made * true).sum((0, 3)), (true * true).sum((0, 3))], -1)
        sums += pixel_sums(gaussians, maps, capture.viewmats[chosen[0]], capture.Ks[chosen[0]])
    model, both, truth = sums.T
    norm = np.sqrt(model * truth)
    return np.divide(both, norm, out=np.zeros_like(both), where=norm > 0)


def looked_at(n_timesteps: int, fps: float, frequency_hz: float) -> list[int]:
    """Return at most `_TIMES` timesteps over the first period, or over a shorter record.

    Over the complete record they could all show the same phase.
    """
    period = fps / frequency_hz if frequency_hz > 0 else n_timesteps
    last = min(n_timesteps, max(round(period), 2)) - 1
    return [int(t) for t in np.unique(np.linspace(0, last, _TIMES).round())]


def rms_motion(motion: ModalMotion) -> np.ndarray:
    """Return the rms over modes of the phasors' lengths, [N], scene units."""
    return np.sqrt((np.abs(motion.displacement.astype(np.complex128)) ** 2).sum((0, 2)) / 2)


def measure(
    place: Path, data: BenchSet, training: Training, plan: BenchPlan, donor: Path | None = None
) -> dict[str, Any]:
    """Train and score in the folder `place`, or read the complete figures of an earlier call.

    donor: a run folder with a space stage of the same settings and data, which is copied, since training would give the
    same bits. Raises RunError if `place` has a run of other settings, Tg4mmError if the data do not allow these.
    Returns {request, log, model, rows, displacement, …}, see `_figures`.
    """
    request = _request(data, training, plan)
    kept = read_figures(place)
    if kept is not None and kept["request"] == request:
        return kept
    made = _made_by(place)
    run = _trained(place / "run", data, training, plan.device, donor)
    scores: dict[Key, dict[str, float]] = {}
    metrics = {}
    for way in training.ways:
        metrics[way.name] = _scored(run, way, data, plan, place, scores)
        # Scores of one way to magnify; those at rest and by the exact motion apply to all ways.
        for key in [key for key in scores if key[0][:1] == (OURS,)]:
            del scores[key]
    figures = _figures(run, request, training, metrics) | {"observed": _observed(run, data, plan)}
    figures |= {} if made is None else {"made": made}
    write_sealed(place / FIGURES, figures)
    return figures


def check_plan(sets: Sequence[BenchSet], plan: BenchPlan) -> None:
    """Raise Tg4mmError for an α without ground truth and for unreadable weights, before hours of training."""
    check_alphas(sets, plan.alphas)
    if plan.lpips_weights:
        load_lpips(plan.lpips_weights)
    if not has_flip():
        warnings.warn(f"FLIP is not measured: {NO_FLIP}", stacklevel=2)


def warm_up(place: Path, sets: Sequence[BenchSet], presets: Iterable[str], device: str) -> None:
    """Compile and load the kernels by a training of one iteration, so that no run's seconds include that.

    It uses the first trainable set. Errors are left to the run.
    """
    for preset in presets:
        modal = {"space.iterations": "1", "motion.iterations": "1", "motion.components": "1"}
        paper = {"paper.warm_up": "1", "paper.iterations": "2", "paper.motion_iterations": "1"}
        folder = place / f".warm-up-{preset}"
        for data in sets:
            shutil.rmtree(folder, ignore_errors=True)
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    train(data.root, folder, preset, device, modal if preset == "modal" else paper)
            except Exception:
                continue
            break
        shutil.rmtree(folder, ignore_errors=True)


def is_measured(place: Path, data: BenchSet, training: Training, plan: BenchPlan) -> bool:
    """Return whether `measure` would find its figures."""
    kept = read_figures(place)
    return kept is not None and kept["request"] == _request(data, training, plan)


def read_figures(place: Path) -> dict[str, Any] | None:
    """Read the figures in `place`; None if this version cannot read them."""
    try:
        return read_formed(place / FIGURES, FORM)
    except (OSError, ValueError):  # damaged; the run is complete, and is scored again
        return None


def alphas_of(data: BenchSet, plan: BenchPlan) -> list[int]:
    """Return 0, the test split itself, and the requested α with ground truth."""
    return [0, *(a for a in data.alphas if plan.alphas is None or a in plan.alphas)]


def _request(data: BenchSet, training: Training, plan: BenchPlan) -> dict[str, Any]:
    configs = parse_settings(training.settings, training.preset)
    trainer = {} if training.trainer is None else {"trainer": training.trainer.plain()}
    return trainer | {
        "dataset": str(data.root),
        "digest": data.digest,
        "truth": {f"{a:g}": truth_state(data, a) for a in alphas_of(data, plan)},
        "preset": training.preset,
        "settings": {stage: dataclasses.asdict(config) for stage, config in configs.items()},
        "scorings": [dataclasses.asdict(s) for s in training.ways],
        "alphas": None if plan.alphas is None else list(plan.alphas),
        "band_hz": plan.band(data),
        "device": plan.device,
        "metrics": list(plan.metrics),
        **({"lpips": weights_state(plan)} if "lpips" in plan.metrics else {}),
    }


def weights_state(plan: BenchPlan) -> list[Any]:
    """Return the state of the files of LPIPS' weights, as `files_state`."""
    return [files_state([path], path.parent) for path in plan.lpips_weights]


def _made_by(place: Path) -> dict[str, Any] | None:
    """Note version, time and machine before a run's training; None for a run without that note."""
    record = place / MADE
    if not (place / "run").is_dir():
        place.mkdir(parents=True, exist_ok=True)
        write_sealed(record, circumstances())
    try:
        return read_formed(record, CIRCUMSTANCES)
    except (OSError, ValueError):
        return None


def _trained(place: Path, data: BenchSet, training: Training, device: str, donor: Path | None) -> Run:
    place.parent.mkdir(parents=True, exist_ok=True)
    gc.collect()  # for each stage's peak memory
    _check_device(place, device)
    if training.trainer is not None:
        return training.trainer(data.root, place, training.settings, device)
    if donor is not None and not (place / "space.safetensors").exists():
        _take_space(place, data, training, donor)
    return train(data.root, place, training.preset, device, training.settings)


def _check_device(place: Path, device: str) -> None:
    """Raise RunError for a run with a stage of another device, whose seconds are not comparable."""
    log = Run.open(place).log() if place.is_dir() else {}
    before = "cuda" if any("peak_gpu_memory_mib" in stage for stage in log.values()) else "cpu"
    if log and before != device:
        raise RunError(f"{place} was trained with --device {before}, not {device}; choose another --out")


def _take_space(place: Path, data: BenchSet, training: Training, donor: Path) -> None:
    configs = parse_settings(training.settings, training.preset)
    plain = {stage: dataclasses.asdict(config) for stage, config in configs.items()}
    given = Run.open(donor)
    # The preset paper replaces its base Gaussians by the decoded ones, which are of no use here.
    if (given.preset, training.preset) != ("modal", "modal") or given.settings["space"] != plain["space"]:
        return
    run = Run.create(place, data.root, training.preset, plain)
    run.save_space(given.load_space(), given.log()["space"])


def _scored(
    run: Run, way: Scoring, data: BenchSet, plan: BenchPlan, place: Path, scores: dict[Key, dict[str, float]]
) -> dict[str, Any]:
    return evaluate_run(
        run,
        alphas=plan.alphas,
        out=place / f"metrics_{safe_name(way.name)}.json",
        magnified=way.magnified(plan.bands(data)),
        device=plan.device,
        scores=scores,
        lpips_weights=plan.lpips_weights or None,
        metrics=plan.metrics,
    )


def _observed(run: Run, data: BenchSet, plan: BenchPlan) -> dict[str, float | None]:
    train = load_capture(data.root)
    return observed_figures(subject_of(run, train, AS_CAPTURED, {}, plan.device), data, train)


def _figures(
    run: Run, request: dict[str, Any], training: Training, metrics: Mapping[str, dict[str, Any]]
) -> dict[str, Any]:
    """Return {version, request, log, seconds, model, n_gaussians, mib_on_disk, rows, displacement, notes, …}.

    rows: {α: {"nothing moves": {ssim, …: None but for the plan's metrics}, <each way's name>: …, "ceiling": …}}, α as
    text, since JSON has no other keys; a way's row also has closure, change_gain, change_residual of `evaluate_run`.
    """
    rows: dict[str, dict[str, Any]] = {}
    for name, figures in metrics.items():
        for entry in figures["alphas"]:
            scored = rows.setdefault(f"{entry['alpha']:g}", {})
            for method, values in entry["rows"].items():
                seen = {k: entry[k] for k in SEEN} if method == OURS else {}
                scored[name if method == OURS else method] = values | seen
    order = [STATIC, *metrics, CEILING]
    first = next(iter(metrics.values()))
    return {
        "version": VERSION,
        "request": request,
        "log": run.log(),
        "seconds": stage_seconds(run.log()),
        "model": model_hash(run.path),
        "n_gaussians": len(run.load_space()),
        "mib_on_disk": disk_mib(run),
        "rows": {a: {m: row[m] for m in order if m in row} for a, row in rows.items()},
        "displacement": first["displacement"],
        "strongest_hz": strongest_hz(run),
        "absent": {k: v for figures in metrics.values() for k, v in figures["absent"].items()},
        "notes": sorted({note for figures in metrics.values() for note in figures["notes"]}),
    }


def strongest_hz(run: Run) -> float | None:
    """Return the frequency of the run's mode with the largest rms displacement; None without a vibration."""
    motion = run.load_motion()
    if motion is None or not (motion.freqs_hz > 0).any():
        return None
    size = motion.powers() * (motion.freqs_hz > 0)
    return float(motion.freqs_hz[int(size.argmax())])


def stage_seconds(log: Mapping[str, Any]) -> dict[str, float]:
    """Return the seconds of the space stage (of `paper`: base and triplane), the motion stage, and both."""
    motion = float(log.get("motion", {}).get("seconds") or 0.0)
    space = sum(float(entry.get("seconds") or 0.0) for stage, entry in log.items() if stage != "motion")
    return {"space": space, "motion": motion, "total": space + motion}


def stage_costs(log: Mapping[str, Any]) -> dict[str, float | None]:
    """Return {space_iterations, motion_iterations, space_peak_mib, motion_peak_mib} for the stages of `stage_seconds`.

    Iterations of a stage are summed, and its memory (MiB) is the maximum; None if the log has none.
    """
    costs: dict[str, float | None] = {}
    for stage in ("space", "motion"):
        entries = [entry for name, entry in log.items() if (name == "motion") == (stage == "motion")]
        known = {
            key: [float(e[key]) for e in entries if e.get(key)] for key in ("iterations", "peak_memory_mib")
        }
        costs[f"{stage}_iterations"] = sum(known["iterations"]) or None
        costs[f"{stage}_peak_mib"] = max(known["peak_memory_mib"], default=None)
    return costs
