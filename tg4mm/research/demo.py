"""The whole main job, small, from nothing: generate, train, render, evaluate, export, report."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.work_folder import FolderStep, WorkFolder, clock, run_steps

STEPS_FILE = "demo.json"
ALPHA = 20.0
ORBIT_FRAMES = 120
SAMPLES = 32  # light paths a pixel; a third of the generator's default renders in half the time
SIZES = (16, 4096)  # smallest and largest picture, pixels
Printer = Callable[[str], None]


class Places:
    """Paths of the demo's parts under one folder."""

    def __init__(self, root: Path) -> None:
        self.root, self.data, self.run = root, root / "data", root / "run"
        self.metrics, self.report = self.run / "metrics.json", root / "report.html"
        self.magnified, self.orbit, self.splat = root / "magnified", root / "orbit", root / "splat.ply"

    @property
    def dataset(self) -> Path:
        """The one dataset in data/. Raises Tg4mmError if there is none or more."""
        found = sorted(path.parent for path in self.data.glob("*/scene.json"))
        if len(found) != 1:
            names = ", ".join(path.name for path in found) or "none"
            raise Tg4mmError(f"{self.data} should hold one dataset, it holds: {names}")
        return found[0]


def run_demo(out: Path, size: int = 128, full: bool = False, say: Printer = print) -> Path:
    """Do the main job at `size`×`size` pixels under the folder `out`; returns the report's path.

    full: render with the generator's default number of samples instead of SAMPLES.
    Finished steps are skipped, so the same call resumes after a kill. Raises Tg4mmError where `out` holds
    anything but a demo with these arguments, or a step fails.
    """
    if not SIZES[0] <= size <= SIZES[1]:
        raise Tg4mmError(f"--size {size}: expected {SIZES[0]} … {SIZES[1]} pixels")
    places = Places(Path(out))
    began = time.monotonic()
    record = {"format": "tg4mm-demo", "version": 3, "size": size, "full": full}
    folder = WorkFolder(places.root, STEPS_FILE, free=("done",))
    folder.claim(record, {**record, "done": {}})
    run_steps(folder, record, demo_steps(places, size, full), say)
    _say_results(places, clock(time.monotonic() - began), say)
    return places.report


def demo_steps(places: Places, size: int, full: bool) -> list[FolderStep]:
    """The steps in order; each calls what the command line calls."""
    parts: list[tuple[str, str, Path, Callable[[], object]]] = [
        (
            "generate",
            f"Generate the mic scene, {size}×{size}",
            places.data,
            lambda: _generate(places, size, full),
        ),
        (
            "train",
            "Train: Gaussians at rest, then their motion",
            places.run / "motion.safetensors",
            lambda: _train(places),
        ),
        ("render", f"Render the test cameras, α = {ALPHA:g}", places.magnified, lambda: _render(places)),
        ("orbit", f"Render an orbit, α = {ALPHA:g}", places.orbit, lambda: _orbit(places)),
        ("evaluate", "Compare with ground truth", places.metrics, lambda: _evaluate(places)),
        ("export", "Export the splat file", places.splat, lambda: _export(places)),
        ("report", "Write the report", places.report, lambda: _report(places)),
    ]
    names = [name for name, *_ in parts]
    folders = {"train": places.run}
    return [FolderStep(*part, after=names[:i], folder=folders.get(part[0])) for i, part in enumerate(parts)]


def _generate(places: Places, size: int, full: bool) -> None:
    from tg4mm.research.generator import run_generator

    # Ground truth of another α would be rendered and scored for nothing.
    arguments = ["mic", "--out", str(places.data), "--size", str(size), "--alphas", f"{ALPHA:g}"]
    status = run_generator([*arguments, *([] if full else ["--samples", str(SAMPLES)])])
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
    render_sequence(Run.open(places.run), cameras, _request(), places.magnified)


def _orbit(places: Places) -> None:
    from tg4mm.capture import load_capture
    from tg4mm.run import Run
    from tg4mm.show.render.cameras import orbit
    from tg4mm.show.render.sequence import render_orbit

    cameras = orbit(load_capture(places.dataset), ORBIT_FRAMES)
    render_orbit(Run.open(places.run), cameras, _request(), places.orbit)


def _evaluate(places: Places) -> None:
    from tg4mm.research.evaluate.run import evaluate_run, format_table
    from tg4mm.run import Run

    print(format_table(evaluate_run(Run.open(places.run), out=places.metrics)), end="")


def _export(places: Places) -> None:
    from tg4mm.run import Run
    from tg4mm.show.export.splat import export_ply

    export_ply(Run.open(places.run), places.splat)


def _report(places: Places) -> None:
    from tg4mm.run import Run
    from tg4mm.run.log import read_figures
    from tg4mm.show.report import ReportOptions, write_report

    metrics = read_figures(places.metrics)
    files = {"splat file": places.splat, "magnified pictures": places.magnified, "orbit": places.orbit}
    options = ReportOptions(alpha=ALPHA, orbit=places.orbit, files=files, metrics=metrics)
    write_report(Run.open(places.run), places.report, options)


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
