"""The whole main job, small, from nothing: generate, train, render, evaluate, export, report."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tg4mm.core.errors import RunError, Tg4mmError
from tg4mm.core.files import write_json
from tg4mm.core.untrusted import read_json
from tg4mm.core.work_folder import WorkFolder

STEPS_FILE = "demo.json"
ALPHA = 20.0
ORBIT_FRAMES = 120
SIZES = (16, 4096)  # smallest and largest picture, pixels
Printer = Callable[[str], None]


@dataclass(frozen=True)
class Places:
    """Where the demo keeps what, under one folder."""

    root: Path

    @property
    def data(self) -> Path:
        return self.root / "data"

    @property
    def dataset(self) -> Path:
        """The one dataset in data/. Raises Tg4mmError if there is none or more."""
        found = sorted(path.parent for path in self.data.glob("*/scene.json"))
        if len(found) != 1:
            names = ", ".join(path.name for path in found) or "none"
            raise Tg4mmError(f"{self.data} should hold one dataset, it holds: {names}")
        return found[0]

    @property
    def run(self) -> Path:
        return self.root / "run"

    @property
    def metrics(self) -> Path:
        return self.run / "metrics.json"

    @property
    def magnified(self) -> Path:
        return self.root / "magnified"

    @property
    def orbit(self) -> Path:
        return self.root / "orbit"

    @property
    def splat(self) -> Path:
        return self.root / "splat.ply"

    @property
    def report(self) -> Path:
        return self.root / "report.html"


@dataclass(frozen=True)
class Step:
    """One step: what it does, the file or folder that shows it was done, and how."""

    name: str
    title: str
    result: Path
    work: Callable[[], object]


def run_demo(out: Path, size: int = 128, say: Printer = print) -> Path:
    """Do the main job at `size`×`size` pixels under the folder `out`; returns the report's path.

    Finished steps are skipped, so the same call goes on after a kill. Raises Tg4mmError where `out` holds
    anything but a demo of this size, or a step fails.
    """
    if not SIZES[0] <= size <= SIZES[1]:
        raise Tg4mmError(f"--size {size}: expected {SIZES[0]} … {SIZES[1]} pixels")
    places = Places(Path(out))
    steps = demo_steps(places, size)
    began = time.monotonic()
    done = _read_done(places.root, size)
    redo = False  # what follows a step that was done anew is done anew
    for i, step in enumerate(steps, 1):
        label = f"[{i}/{len(steps)}] {step.title}"
        if not redo and step.name in done and step.result.exists():
            say(f"{label}: already done")
            continue
        redo = True
        say(f"{label} …")
        start = time.monotonic()
        step.work()
        done = {
            **{s.name: done[s.name] for s in steps[: i - 1]},
            step.name: round(time.monotonic() - start, 2),
        }
        write_json(places.root / STEPS_FILE, _record(size, done))
        say(f"{label}: {_clock(time.monotonic() - start)}")
    _say_results(places, _clock(time.monotonic() - began), say)
    return places.report


def demo_steps(places: Places, size: int) -> list[Step]:
    """The steps in order; each calls what the command line calls."""
    return [
        Step(
            "generate", f"Generate the mic scene, {size}×{size}", places.data, lambda: _generate(places, size)
        ),
        Step(
            "train",
            "Train: Gaussians at rest, then their motion",
            places.run / "motion.safetensors",
            lambda: _train(places),
        ),
        Step("render", f"Render the test cameras, α = {ALPHA:g}", places.magnified, lambda: _render(places)),
        Step("orbit", f"Render an orbit, α = {ALPHA:g}", places.orbit / "orbit.mp4", lambda: _orbit(places)),
        Step("evaluate", "Compare with ground truth", places.metrics, lambda: _evaluate(places)),
        Step("export", "Export the splat file", places.splat, lambda: _export(places)),
        Step("report", "Write the report", places.report, lambda: _report(places)),
    ]


def _record(size: int, done: Mapping[str, float]) -> dict[str, Any]:
    return {"format": "tg4mm-demo", "version": 1, "size": size, "done": dict(done)}


def _read_done(root: Path, size: int) -> dict[str, float]:
    """Seconds of the finished steps. A new or empty folder becomes a demo's; any other without one is refused."""
    folder = WorkFolder(root, STEPS_FILE, free=("done",))
    folder.claim(_record(size, {}))
    try:
        return {str(k): float(v) for k, v in (folder.read() or {})["done"].items()}
    except (KeyError, TypeError, ValueError, AttributeError):
        raise RunError(
            f"{root / STEPS_FILE}: is not the record of a demo; remove it or choose another --out"
        ) from None


def _generate(places: Places, size: int) -> None:
    from tg4mm.research.generator import run_generator

    status = run_generator(["mic", "--out", str(places.data), "--size", str(size)])
    if status != 0:
        raise Tg4mmError(f"the dataset generator ended with status {status}; see its message above")


def _train(places: Places) -> None:
    from tg4mm.run.train import train

    train(places.dataset, places.run, "modal", "cpu", {})


def _request() -> Any:
    from tg4mm.core.magnification import Magnification
    from tg4mm.show.render.sequence import RenderRequest

    return RenderRequest(Magnification.of(ALPHA))


def _render(places: Places) -> None:
    from tg4mm.capture import load_capture
    from tg4mm.run import Run
    from tg4mm.show.render.cameras import capture_cameras
    from tg4mm.show.render.sequence import render_sequence

    cameras = capture_cameras(load_capture(places.dataset, split="test"))
    render_sequence(Run.open(places.run), cameras, _request(), _fresh(places.magnified, places.run))


def _orbit(places: Places) -> None:
    from tg4mm.capture import load_capture
    from tg4mm.run import Run
    from tg4mm.show.render.cameras import orbit
    from tg4mm.show.render.sequence import render_orbit

    cameras = orbit(load_capture(places.dataset), ORBIT_FRAMES)
    render_orbit(Run.open(places.run), cameras, _request(), _fresh(places.orbit, places.run))


def _fresh(folder: Path, run: Path) -> Path:
    """The folder, cleared of a rendering of another model: the demo made both, so it need not refuse.

    Only pictures and videos beside a render.json of ours are deleted; whatever else lies there stays.
    """
    from tg4mm.run.tensor_file import model_hash
    from tg4mm.show.render.sequence import FORMAT, RECORD

    try:
        record = read_json(folder / RECORD)
    except (OSError, ValueError):
        return folder
    if isinstance(record, dict) and record.get("format") == FORMAT and record.get("model") != model_hash(run):
        for pattern in ("*.png", "*/*.png", "*.mp4"):
            for path in folder.glob(pattern):
                path.unlink()
        (folder / RECORD).unlink()  # last, so that a kill in between leaves the folder ours
    return folder


def _evaluate(places: Places) -> None:
    from tg4mm.research.evaluate.run import evaluate_run
    from tg4mm.research.evaluate.table import format_table
    from tg4mm.run import Run

    print(format_table(evaluate_run(Run.open(places.run), out=places.metrics)), end="")


def _export(places: Places) -> None:
    from tg4mm.run import Run
    from tg4mm.show.export.splat import export_ply

    export_ply(Run.open(places.run), places.splat)


def _report(places: Places) -> None:
    from tg4mm.run import Run
    from tg4mm.run.figures_file import read_figures
    from tg4mm.show.report import ReportOptions, write_report

    metrics = read_figures(places.metrics)
    files = {"splat file": places.splat, "magnified pictures": places.magnified, "orbit": places.orbit}
    options = ReportOptions(alpha=ALPHA, orbit=places.orbit, files=files, metrics=metrics)
    write_report(Run.open(places.run), places.report, options)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"


def _say_results(places: Places, took: str, say: Printer) -> None:
    films = sorted(places.magnified.glob("*.mp4"))
    say(f"\nDone in {took}. Open first:\n")
    say(f"  {places.report}    everything on one page, in any browser\n")
    say("Also there:\n")
    rows = [(films[0], "the magnified video of one test camera")] if films else []
    rows += [
        (places.orbit / "orbit.mp4", "the magnified scene from a moving camera"),
        (places.splat, "the scene with its motion: any splat viewer, or Blender with the tg4mm extension"),
        (places.metrics, "the scores"),
        (places.dataset, "the dataset with its ground truth"),
        (places.run, "the trained run, for tg4mm render, evaluate and export"),
    ]
    for path, what in rows:
        say(f"  {path}    {what}")
