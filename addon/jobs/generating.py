"""Start the generator on a copy of the open scene, and handle its end."""

import contextlib
import os
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy

from dataset_gen.cameras import KINDS
from dataset_gen.errors import GenerateError
from tg4mm.core.files import write_json

from .. import names, preferences
from . import commands, kinds, objects
from .commands import Host
from .runner import Job, JobState

_BLEND, _MOTION = "scene.blend", "motion.json"


def core_python(context: Any) -> str:
    """Return the core's Python from the preferences, "" if unset. Raises GenerateError if the file does not exist."""
    named = preferences.get(context).core_python.strip()
    if not named:
        return ""
    # Not resolved further: in a virtual environment it is a link, and what it is called tells which.
    path = os.path.abspath(bpy.path.abspath(named))
    if not os.path.isfile(path):
        raise GenerateError(f"Python of the Core (in the preferences): file {path} does not exist")
    return path


def host(context: Any) -> Host:
    """Return the host of the generator: the core's Python if set, else this Blender. Raises GenerateError."""
    python = "" if context.scene.tg4mm_generate.in_blender else core_python(context)
    return (
        commands.core_host(python) if python else commands.blender_host(bpy.app.binary_path, sys.executable)
    )


def label(settings: Any) -> str:
    """Return the first part of the dataset folder's name."""
    if settings.label:
        return str(settings.label)
    return re.sub(r"[^A-Za-z0-9_-]+", "_", Path(bpy.data.filepath).stem).strip("_") or "scene"


def folder(what: str, text: str) -> Path:
    """Return the absolute path of a folder setting called `what`. Raises GenerateError."""
    if not text.strip():
        raise GenerateError(f"{what} is empty: choose a folder")
    if text.startswith("//") and not bpy.data.filepath:
        raise GenerateError(f"{what} {text} lies beside the .blend file, which is not saved yet")
    return Path(os.path.abspath(bpy.path.abspath(text)))


def working_folder(settings: Any) -> Path:
    """Return the folder that holds the copy of the scene until the dataset is complete. Raises GenerateError."""
    out, name = folder("Output", settings.out), label(settings)
    if not re.fullmatch(r"[A-Za-z0-9_-]+", name):
        raise GenerateError(f"Name {name!r}: use letters, digits, - and _ only, because it names a folder")
    return out / f"{name}.generating"


def can_go_on(settings: Any) -> bool:
    """Return whether an unfinished dataset of this name exists."""
    try:
        return os.path.isfile(working_folder(settings) / _BLEND)  # False too where it may not be looked at
    except GenerateError:
        return False


def generate(context: Any, go_on: bool, then: Callable[[Any], Any]) -> Job:
    """Start the generator on a copy of the open scene, or with `go_on` on the copy that a stopped run left.

    With Then Train, `then(context)` is called at the end. Raises GenerateError or OSError, one line.
    """
    settings = context.scene.tg4mm_generate
    chosen = objects.moving(settings)
    parts = objects.parts(chosen, context.evaluated_depsgraph_get())
    described = kinds.description(settings, parts)
    if described.main.frequency_hz >= settings.fps / 2:
        raise GenerateError(
            f"Frequency {described.main.frequency_hz:g} Hz is not below half of the Frame Rate, "
            f"{settings.fps / 2:g} Hz"
        )
    runs_in, work = host(context), working_folder(settings)
    work.mkdir(parents=True, exist_ok=True)
    motion = work / _MOTION
    write_json(motion, described.to_json())
    if not go_on:
        save_copy(work / _BLEND, context.scene)
    options = _options(settings, context.scene, runs_in)
    steps = commands.generate_steps(runs_in, work / _BLEND, motion, work.parent, options)
    return commands.start(commands.GENERATE, steps, lambda job: _ended(job, work, then))


def save_copy(path: Path, scene: Any) -> None:
    """Save the session as a .blend without imported splats. Raises GenerateError."""
    with _splats_hidden(scene):
        try:
            bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True, check_existing=False)
        except RuntimeError as error:
            reason = " ".join(str(error).removeprefix("Error: ").split())
            raise GenerateError(f"{path} cannot be saved: {reason}") from None


@contextlib.contextmanager
def _splats_hidden(scene: Any) -> Iterator[None]:
    """Hide imported splats: a dataset shows the scene, not the result of an earlier one."""
    splats = [obj for obj in scene.objects if names.MARK in obj and not obj.hide_render]
    for obj in splats:
        obj.hide_render = True
    try:
        yield
    finally:
        for obj in splats:
            obj.hide_render = False


def _options(settings: Any, scene: Any, runs_in: Host) -> dict[str, str | int | float]:
    given = (
        "timesteps",
        "fps",
        "cameras",
        "views",
        "test_views",
        "size",
        "samples",
        "seed",
        "device",
        "alphas",
    )
    options: dict[str, str | int | float] = {"name": label(settings), "scene": scene.name}
    options |= {name.replace("_", "-"): getattr(settings, name) for name in (*given, "processes")}
    # Blender's own Python lacks OpenEXR, which writes it.
    options["truth"] = settings.truth if runs_in.is_core else "none"
    # The generator refuses what would change nothing.
    if KINDS[settings.cameras].single:
        del options["views"]
    if settings.cameras == "flat":
        options["test-views"] = min(settings.test_views, 1)
    if not settings.test_views:
        del options["alphas"]
        if options["truth"] == "test":
            options["truth"] = "none"
    return options


def _ended(job: Job, work: Path, then: Callable[[Any], Any]) -> None:
    """Delete the scene copy of a finished dataset and select the dataset in the Train panel."""
    if job.state is not JobState.DONE or not job.results:
        return
    with contextlib.suppress(OSError):
        for name in (_BLEND, f"{_BLEND}1", _MOTION):
            (work / name).unlink(missing_ok=True)
        work.rmdir()
    job.message = f"Complete: {job.results[-1]}"
    scene = bpy.context.scene
    scene.tg4mm_train.dataset = job.results[-1]
    if scene.tg4mm_generate.then_train:
        then(bpy.context)
