"""Training from a dataset to a run folder: settings, then the space stage, then the motion stage."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from tg4mm.capture import load_capture, load_images
from tg4mm.device import check_device
from tg4mm.errors import Tg4mmError
from tg4mm.motion.config import MotionConfig
from tg4mm.motion.differences import fixed_cameras
from tg4mm.motion.train import checked as checked_motion
from tg4mm.motion.train import train_motion
from tg4mm.runs import Run
from tg4mm.space import SpaceConfig, rest_views, train_space
from tg4mm.space.train import checked as checked_space

PRESETS = ("modal",)
C = TypeVar("C")
_STAGES = {"space": SpaceConfig, "motion": MotionConfig}


def parse_settings(pairs: Mapping[str, str]) -> dict[str, Any]:
    """Configurations of all stages from `{"space.iterations": "3000", …}`.

    Raises Tg4mmError for a name that is none, with those there are, and for a value of the wrong type.
    """
    chosen: dict[str, dict[str, Any]] = {stage: {} for stage in _STAGES}
    for name, text in pairs.items():
        stage, _, key = name.partition(".")
        fields = {f.name: f for f in dataclasses.fields(_STAGES[stage])} if stage in _STAGES else {}
        if key not in fields:
            known = [f"{s}.{f.name}" for s, c in _STAGES.items() for f in dataclasses.fields(c)]
            raise Tg4mmError(f"setting {name!r} is unknown; there are: {', '.join(known)}")
        kind: Any = type(fields[key].default)
        try:
            chosen[stage][key] = kind(text)
        except ValueError:
            raise Tg4mmError(f"setting {name} is {text!r}, expected {kind.__name__}") from None
    return {stage: config(**chosen[stage]) for stage, config in _STAGES.items()}


def train(
    dataset: Path | str,
    run_path: Path | str,
    preset: str = "modal",
    device: str = "cpu",
    settings: Mapping[str, str] | None = None,
) -> Run:
    """Train on a dataset (design §4.2, any layout `load_capture` reads) into the folder `run_path`.

    Stages that are complete there are skipped, an unfinished one goes on from its checkpoint. A capture of one
    timestep ends after the space stage. settings: `{"space.iterations": "3000", …}`.
    Raises Tg4mmError (CaptureError, RunError) on bad input.
    """
    if preset not in PRESETS:
        raise Tg4mmError(f"preset is {preset!r}, expected {' or '.join(PRESETS)}")
    check_device(device)
    configs = parse_settings(settings or {})
    # before the run folder exists, which would keep the bad value, and before minutes of the space stage
    checked_space(configs["space"])
    checked_motion(configs["motion"])
    capture = load_capture(dataset, split="train")
    needs_motion = capture.n_timesteps > 1
    if needs_motion:
        fixed_cameras(capture)  # raises where no camera stays put
    plain = {stage: dataclasses.asdict(config) for stage, config in configs.items()}
    is_new = not (Path(run_path) / "config.json").exists()
    run = Run.create(run_path, capture.root, preset, plain)
    if run.has_space and (run.has_motion or not needs_motion):
        return run
    try:
        images = load_images(capture)
        if not run.has_space:
            train_space(run, rest_views(capture, images), capture.points, configs["space"], device)
    except Tg4mmError:
        if is_new and not run.has_space:
            run.discard()  # settings that do not fit these data must not stay with the folder
        raise
    if needs_motion:
        train_motion(run, capture, images, configs["motion"], device)
    return run
