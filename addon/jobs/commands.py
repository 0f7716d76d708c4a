"""Command lines of background programs, and the jobs that run them, polled by a timer."""

import atexit
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

import dataset_gen

from .runner import Job, JobStep

GENERATOR = Path(str(dataset_gen.__file__)).with_name("blender_main.py")
INTERVAL_S = 0.25
GENERATE, TRAIN = "generate", "train"  # the kinds


@dataclass(frozen=True)
class Host:
    """The interpreter that runs the generator."""

    command: tuple[str, ...]  # before the generator's own arguments
    is_core: bool  # whether it is the environment that tg4mm is installed in


def core_host(python: str) -> Host:
    """Return the environment in which tg4mm is installed as host."""
    return Host((python, "-m", "dataset_gen"), True)


def blender_host(blender: str, python: str) -> Host:
    """Return this Blender as host; if bpy is a Python module (`blender` is ""), its interpreter."""
    if not blender:
        return Host((python, str(GENERATOR), "--"), False)
    start = (blender, "--background", "--factory-startup", "--python-exit-code", "1", "--python")
    return Host((*start, str(GENERATOR), "--"), False)


def generate_steps(
    host: Host, blend: Path, motion: Path, out: Path, options: Mapping[str, str | int | float]
) -> list[JobStep]:
    """Return the generation steps for generator `options`, whose names are given without dashes."""
    arguments = [text for name, value in options.items() for text in (f"--{name}", _text(value))]
    files = ("--blend", str(blend), "--motion", str(motion), "--out", str(out))
    return [JobStep("reading the scene", (*host.command, *files, *arguments))]


def train_steps(
    python: str, dataset: Path, run: Path, splat: Path, device: str, settings: Sequence[str] = ()
) -> list[JobStep]:
    """Return the steps that train on a dataset and write the splat file; `settings` such as "space.iterations=3000"."""
    sets = [text for pair in settings for text in ("--set", pair)]
    core = (python, "-m", "tg4mm")
    train = (*core, "train", str(dataset), "--out", str(run), "--device", device, *sets)
    export = (*core, "export", str(run), "--out", str(splat), "--format", "ply")
    return [JobStep("starting to train", train), JobStep("writing the splats", export)]


def video_steps(
    python: str, video: Path, out: Path, splat: Path, device: str, quick: bool, settings: Sequence[str] = ()
) -> list[JobStep]:
    """Return the steps that look at a video, train on it in the folder `out` and write the splat file."""
    sets = [text for pair in settings for text in ("--set", pair)]
    core = (python, "-m", "tg4mm")
    how = ("--device", device, *(("--quick",) if quick else ()), *sets)
    look = (*core, "look", str(video), "--out", str(out.with_name(f"{video.stem}-look")))
    process = (*core, "process", str(video), "--out", str(out), *how)
    export = (*core, "export", str(out / "run"), "--out", str(splat), "--format", "ply")
    # Of a camera that moves, look may find nothing to say.
    first = JobStep("looking at the video", look, optional=True)
    return [first, JobStep("starting to train", process), JobStep("writing the splats", export)]


def environment() -> dict[str, str]:
    """Return an environment for a child Python: unbuffered UTF-8 output, progress as events
    (tg4mm/core/progress.py), no imports from the current folder."""
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONHOME", "PYTHONSTARTUP")}
    return kept | {"PYTHONUNBUFFERED": "1", "PYTHONUTF8": "1", "PYTHONSAFEPATH": "1", "TG4MM_EVENTS": "json"}


def _text(value: str | int | float) -> str:
    return f"{value:.9g}" if isinstance(value, float) else str(value)


_jobs: dict[str, Job] = {}
_ends: dict[str, Callable[[Job], None]] = {}


def get(kind: str) -> Job | None:
    """Return the running job of a kind, or the last one that ran."""
    return _jobs.get(kind)


def running(kind: str) -> bool:
    """Return whether a job of this kind is running."""
    job = _jobs.get(kind)
    return job is not None and job.running


def start(kind: str, steps: Sequence[JobStep], at_end: Callable[[Job], None]) -> Job:
    """Start a job; the timer calls `at_end(job)` when it ends, whether it succeeded or not.

    Raises OSError if it cannot be started, RuntimeError if a job of its kind is running.
    """
    if running(kind):
        raise RuntimeError(f"a job of kind {kind} is already running")
    job = Job(steps, environment())
    _jobs[kind], _ends[kind] = job, at_end
    if not bpy.app.timers.is_registered(tick):
        # Persistent: opening another file does not end the job, nor the watch over it.
        bpy.app.timers.register(tick, first_interval=INTERVAL_S, persistent=True)
    return job


def tick() -> float | None:
    """Poll every job (called by Blender's timer); return None, which stops the timer, when none is running."""
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
    """Terminate every job now, without calling its `at_end`."""
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
