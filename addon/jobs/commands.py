"""Commands of the programs in the background, and the jobs that run them: ticked by a timer, shown, ended."""

import atexit
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

import dataset_gen

from .runner import Job, Step

GENERATOR = Path(str(dataset_gen.__file__)).with_name("blender_main.py")


@dataclass(frozen=True)
class Host:
    """What runs the generator."""

    command: tuple[str, ...]  # before the generator's own arguments
    is_core: bool  # whether it is the environment that tg4mm is installed in


def core_host(python: str) -> Host:
    """The environment that tg4mm is installed in."""
    return Host((python, "-m", "dataset_gen"), True)


def blender_host(blender: str, python: str) -> Host:
    """This Blender, or where it is a Python module, `blender` "", the Python that it is a module of."""
    if not blender:
        return Host((python, str(GENERATOR), "--"), False)
    start = (blender, "--background", "--factory-startup", "--python-exit-code", "1", "--python")
    return Host((*start, str(GENERATOR), "--"), False)


def generate_steps(
    host: Host, blend: Path, motion: Path, out: Path, options: Mapping[str, str | int | float]
) -> list[Step]:
    """`options`: of the generator, without their dashes."""
    arguments = [text for name, value in options.items() for text in (f"--{name}", _text(value))]
    files = ("--blend", str(blend), "--motion", str(motion), "--out", str(out))
    return [Step("reading the scene", (*host.command, *files, *arguments))]


def train_steps(
    python: str, dataset: Path, run: Path, splat: Path, device: str, settings: Sequence[str] = ()
) -> list[Step]:
    """Train on a dataset, then write the splat file. `settings`: "space.iterations=3000" and the like."""
    sets = [text for pair in settings for text in ("--set", pair)]
    core = (python, "-m", "tg4mm")
    train = (*core, "train", str(dataset), "--out", str(run), "--device", device, *sets)
    export = (*core, "export", str(run), "--out", str(splat), "--format", "ply")
    return [Step("starting to train", train), Step("writing the splats", export)]


def environment() -> dict[str, str]:
    """This process's, for a Python of its own: output at once and in UTF-8, what happens as events
    (tg4mm/core/events.py), nothing taken from the folder it is in."""
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONHOME", "PYTHONSTARTUP")}
    return kept | {"PYTHONUNBUFFERED": "1", "PYTHONUTF8": "1", "PYTHONSAFEPATH": "1", "TG4MM_EVENTS": "json"}


def _text(value: str | int | float) -> str:
    return f"{value:.9g}" if isinstance(value, float) else str(value)


INTERVAL_S = 0.25
GENERATE, TRAIN = "generate", "train"  # the kinds

_jobs: dict[str, Job] = {}
_ends: dict[str, Callable[[Job], None]] = {}


def get(kind: str) -> Job | None:
    """The job of a kind that runs, or the last one that did."""
    return _jobs.get(kind)


def running(kind: str) -> bool:
    """Whether a job of a kind runs."""
    job = _jobs.get(kind)
    return job is not None and job.running


def start(kind: str, steps: Sequence[Step], at_end: Callable[[Job], None]) -> Job:
    """Start a job; `at_end(job)` is called from the timer when it has ended, however it has.

    Raises OSError if it cannot be started, RuntimeError if one of its kind runs.
    """
    if running(kind):
        raise RuntimeError(f"a job of kind {kind} runs already")
    job = Job(steps, environment())
    _jobs[kind], _ends[kind] = job, at_end
    if not bpy.app.timers.is_registered(tick):
        # Persistent: opening another file does not end the job, nor the watch over it.
        bpy.app.timers.register(tick, first_interval=INTERVAL_S, persistent=True)
    return job


def tick() -> float | None:
    """Called by Blender's timer: listens to every job; None, the end of the timer, when none runs."""
    changed = False
    for kind, job in list(_jobs.items()):
        was_running = job.running
        changed |= job.poll()
        if was_running and not job.running:
            _ends.pop(kind)(job)
            changed = True
    if changed:
        _redraw()
    return INTERVAL_S if any(job.running for job in _jobs.values()) else None


def close() -> None:
    """End every job now, without calling what was to be called at its end."""
    for job in _jobs.values():
        job.close()
    _jobs.clear()
    _ends.clear()


def _redraw() -> None:
    manager: Any = bpy.context.window_manager
    for window in manager.windows if manager is not None else ():
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


def register() -> None:
    # Blender disables its extensions when it quits; this is for an end without that.
    atexit.register(close)


def unregister() -> None:
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
    close()
    atexit.unregister(close)
