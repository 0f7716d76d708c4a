"""The jobs of this Blender session: at most one of each kind, watched by a timer that lives through file loads."""

from __future__ import annotations

import atexit
from collections.abc import Callable, Sequence
from typing import Any

import bpy

from . import commands
from .runner import Job, Step

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
    job = Job(steps, commands.environment())
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
