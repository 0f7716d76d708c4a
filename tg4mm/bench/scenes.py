"""The benchmark's main table: every preset on every dataset, resumable run by run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tg4mm.bench.folder import FORMAT, VERSION, circumstances, open_folder, write_text
from tg4mm.bench.goals import judge
from tg4mm.bench.means import group_means
from tg4mm.bench.measure import Plan, Training, check_plan, is_measured, measure, peak_mib, warm_up
from tg4mm.bench.page import scenes_page, ssim_chart
from tg4mm.bench.request import check_settings
from tg4mm.bench.sets import BenchSet, open_sets
from tg4mm.errors import Tg4mmError
from tg4mm.files import write_json
from tg4mm.paper.config import PaperConfig
from tg4mm.progress import progress
from tg4mm.train import parse_settings

KIND = "scenes"
SAME_TIME = "modal's time"
SAME_TIME_CHOICES = ("needed", "always", "never")
Printer = Callable[[str], None]


@dataclass(frozen=True)
class ScenesRequest:
    """What to run. same_time: when a `paper` preset is trained once more, for as long as `modal` took: see
    `same_time_training`."""

    presets: tuple[str, ...] = ("modal", "paper-tuned")
    settings: dict[str, dict[str, str]] = field(default_factory=dict)  # by preset, as `--set`
    same_time: str = "needed"
    plan: Plan = field(default_factory=Plan)


def run_scenes(
    roots: Sequence[Path], out: Path, request: ScenesRequest, say: Printer = print
) -> dict[str, Any]:
    """Run what is not finished, and write OUT/results.json and OUT/results.md, anew after every run.

    Raises Tg4mmError (BenchError, CaptureError, RunError) on bad input, before anything is written where that is
    possible.
    """
    if request.same_time not in SAME_TIME_CHOICES:
        raise Tg4mmError(f"--same-time {request.same_time!r}, expected {', '.join(SAME_TIME_CHOICES)}")
    sets = open_sets(roots)
    check_plan(sets, request.plan)
    for preset in request.presets:
        check_settings(request.settings.get(preset, {}), preset)
    open_folder(Path(out), KIND)
    here = circumstances()
    _prepare(sets, out, request, say)
    runs: list[dict[str, Any]] = []
    results: dict[str, Any] = {}
    with progress("benchmark", len(sets) * len(request.presets), unit="runs") as update:
        done = 0
        for data in sets:
            figures: dict[str, dict[str, Any]] = {}
            for preset in request.presets:
                training = Training(preset, preset, request.settings.get(preset, {}))
                say(f"[{done + 1}/{len(sets) * len(request.presets)}] {data.label}, {preset}")
                figures[preset] = measure(_place(out, data, preset), data, training, request.plan)
                runs.append(run_entry(data, preset, training, figures[preset]))
                done += 1
                update(done)
                results = _write(out, here, request, sets, runs)
            for training in same_time_trainings(figures, request):
                say(f"    {data.label}, {training.name}")
                again = measure(_place(out, data, training.name), data, training, request.plan)
                runs.append(run_entry(data, training.name, training, again))
                results = _write(out, here, request, sets, runs)
    return results


def _prepare(sets: Sequence[BenchSet], out: Path, request: ScenesRequest, say: Printer) -> None:
    """Compile what the runs to come will use."""

    def is_open(preset: str) -> bool:
        training = Training(preset, preset, request.settings.get(preset, {}))
        return any(not is_measured(_place(out, s, preset), s, training, request.plan) for s in sets)

    presets = [p for p in request.presets if is_open(p)]
    if presets:
        say("compiling, by one iteration of each stage; its time counts nowhere")
    warm_up(Path(out), sets[0], presets, request.plan.device)


def _place(out: Path, data: BenchSet, name: str) -> Path:
    return Path(out) / "runs" / data.label / name.replace(", ", "-").replace(" ", "_").replace("'", "")


def run_entry(data: BenchSet, row: str, training: Training, figures: dict[str, Any]) -> dict[str, Any]:
    """One run in results.json."""
    return {
        "set": data.label,
        "row": row,
        "preset": training.preset,
        "overrides": dict(training.settings),
        "ways": [way.name for way in training.ways],
        "peak_memory_mib": peak_mib(figures["log"]),
        **{k: v for k, v in figures.items() if k not in {"version", "request"}},
    }


def _write(
    out: Path,
    here: dict[str, Any],
    request: ScenesRequest,
    sets: Sequence[BenchSet],
    runs: list[dict[str, Any]],
) -> dict[str, Any]:
    results: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "kind": KIND,
        "made": here,
        "presets": list(request.presets),
        "same_time": request.same_time,
        "band": "motion ± 1.5 Hz" if request.plan.banded else None,
        "sets": [s.plain() for s in sets],
        "runs": runs,
    }
    results["means"] = group_means(results)
    results["goals"] = judge(results)
    write_json(Path(out) / "results.json", results)
    pictures = {}
    for i, group in enumerate(dict.fromkeys(m["group"] for m in results["means"]), 1):
        if (drawn := ssim_chart(results, group)) is not None:
            pictures[group] = f"results_{i}.svg"
            write_text(Path(out) / pictures[group], drawn)
    write_text(Path(out) / "results.md", scenes_page(results, pictures))
    return results


def same_time_trainings(figures: dict[str, dict[str, Any]], request: ScenesRequest) -> list[Training]:
    """The `paper` presets once more, their iterations scaled to the time that `modal` took on this machine.

    "needed": only where the preset's own iterations took less time than `modal`, so that the comparison would have been
    in favour of `modal`; where it took more it had the advantage already.
    """
    if "modal" not in figures or request.same_time == "never":
        return []
    found = []
    for preset in request.presets:
        if preset == "modal":
            continue
        factor = figures["modal"]["seconds"]["total"] / max(figures[preset]["seconds"]["total"], 1e-9)
        if request.same_time == "always" or factor > 1.0:
            found.append(same_time_training(preset, request.settings.get(preset, {}), factor))
    return found


def same_time_training(preset: str, settings: dict[str, str], factor: float) -> Training:
    """The preset with all its iterations times `factor`.

    The factor is measured, so it differs between machines; the iterations that follow from it are settings like any
    other, stand on the page, and repeat the run bit for bit.
    """
    config: PaperConfig = parse_settings(settings, preset)["paper"]
    warm_up = max(round(config.warm_up * factor), 1)
    scaled = {
        "paper.warm_up": str(warm_up),
        "paper.iterations": str(max(round(config.iterations * factor), warm_up + 1)),
        "paper.motion_iterations": str(max(round(config.motion_iterations * factor), 1)),
    }
    return Training(f"{preset}, {SAME_TIME}", preset, {**settings, **scaled})
