"""Training from a dataset to a run folder: settings, then the stages of the preset, space before motion."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tg4mm.capture import Capture, ImageStack, load_capture, load_images, nerf_synthetic
from tg4mm.capture.part_of import train_command, whole_dataset
from tg4mm.capture.pictures import FilePictures
from tg4mm.capture.readers import READERS
from tg4mm.core.errors import CaptureError, Tg4mmError
from tg4mm.core.settings import unknown
from tg4mm.fit.device import check_device
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.config import checked as checked_motion
from tg4mm.fit.motion.observations import check_shows_motion
from tg4mm.fit.space import SpaceConfig, rest_views
from tg4mm.fit.space.config import checked as checked_space
from tg4mm.research.paper import PAPER, PAPER_TUNED, first_views, train_timesteps, train_triplane
from tg4mm.research.paper.config import base_config
from tg4mm.research.paper.config import checked as checked_paper
from tg4mm.research.paper.model import has_model, load_model
from tg4mm.run import Run
from tg4mm.run.lock import claimed
from tg4mm.run.stages.motion import train_motion
from tg4mm.run.stages.space import train_plane, train_space

# Every preset's settings, by stage, at their defaults. In `paper`, `space` is the fit of the base Gaussians, by L1.
_BASE = SpaceConfig(l2=0.0)
# Bytes of pictures at 8 bits: more stay on disk. 300 timesteps of 512² in 30 views are 9 GiB
IN_MEMORY = 2 << 30
PRESETS: dict[str, dict[str, Any]] = {
    "modal": {"space": SpaceConfig(), "motion": MotionConfig()},
    "paper": {"space": _BASE, "paper": PAPER},
    "paper-tuned": {"space": _BASE, "paper": PAPER_TUNED},
}
_LOG = logging.getLogger("tg4mm")
_BOOLEANS = {"true": True, "false": False}


def parse_settings(pairs: Mapping[str, str], preset: str = "modal") -> dict[str, Any]:
    """Configurations of all stages of a preset from `{"space.iterations": "3000", …}`.

    Raises Tg4mmError for a name that is none, with those that may be meant, and for a value of the wrong type.
    """
    defaults = PRESETS[preset]
    chosen: dict[str, dict[str, Any]] = {stage: {} for stage in defaults}
    for name, text in pairs.items():
        stage, _, key = name.partition(".")
        fields = [f.name for f in dataclasses.fields(defaults[stage])] if stage in defaults else []
        if key not in fields:
            raise unknown(name, defaults)
        chosen[stage][key] = _value(name, text, type(getattr(defaults[stage], key)))
    return {stage: dataclasses.replace(config, **chosen[stage]) for stage, config in defaults.items()}


def _value(name: str, text: str, kind: Any) -> Any:
    try:
        return _BOOLEANS[text.lower()] if kind is bool else kind(text)
    except (ValueError, KeyError):
        expected = "true or false" if kind is bool else kind.__name__
        raise Tg4mmError(f"setting {name} is {text[:60]!r}, expected {expected}") from None


def train(
    dataset: Path | str,
    run_path: Path | str,
    preset: str = "modal",
    device: str = "cpu",
    settings: Mapping[str, str] | None = None,
) -> Run:
    """Train on a dataset (any layout of docs/conventions.md) into the folder `run_path`.

    Stages that are complete there are skipped, an unfinished one goes on from its checkpoint. A capture of one
    timestep ends after the space stage. settings: `{"space.iterations": "3000", …}`.
    Raises Tg4mmError (CaptureError, RunError) on bad input; RunError too while another process trains the run.
    """
    if preset not in PRESETS:
        raise Tg4mmError(f"preset is {preset!r}, expected {' or '.join(PRESETS)}")
    check_device(device)
    configs = parse_settings(settings or {}, preset)
    # before the run folder exists, which would keep the bad value, and before minutes of the space stage
    _check(configs)
    capture = _capture(Path(dataset))
    if capture.n_timesteps > 1 and "motion" in configs:
        check_shows_motion(capture)
    with claimed(run_path):
        return _train(Path(run_path), capture, preset, configs, device)


def _capture(dataset: Path) -> Capture:
    """The capture of a dataset. For a video or pictures, CaptureError with the command that makes a dataset.

    One timestep of a dataset is a still scene, which may be meant; it is said.
    """
    if (part := whole_dataset(dataset)) is not None:
        root, what = part
        if dataset.resolve().parent != root or not nerf_synthetic.recognises(dataset):
            raise CaptureError(f"{dataset}: is no dataset, but {what}: {train_command(root)}")
        _LOG.warning(f"{dataset}: is {what}, by itself a still scene; with its motion: {train_command(root)}")
    if dataset.is_file() or (dataset.is_dir() and not any(reader.recognises(dataset) for reader in READERS)):
        from tg4mm.capture.sfm.sources import suggested_command

        if (command := suggested_command(dataset)) is not None:
            raise CaptureError(f"{dataset}: is no dataset yet; make one with: {command}")
    return load_capture(dataset, split="train")


def _train(run_path: Path, capture: Capture, preset: str, configs: dict[str, Any], device: str) -> Run:
    """What is left of the stages."""
    needs_motion = capture.n_timesteps > 1
    plain = {stage: dataclasses.asdict(config) for stage, config in configs.items()}
    is_new = not (run_path / "config.json").exists()
    run = Run.create(run_path, capture.root, preset, plain)
    if run.has_space and (run.has_motion or not needs_motion) and ("paper" not in configs or has_model(run)):
        return run
    try:
        if "paper" in configs:
            _train_paper(run, capture, load_images(capture), configs, device)
            return run
        images = pictures_for(capture)
        if not run.has_space and capture.kind == "flat":
            train_plane(run, rest_views(capture, images), configs["space"], device)
        elif not run.has_space:
            train_space(run, rest_views(capture, images), capture.points, configs["space"], device)
    except Tg4mmError:
        if is_new and not run.has_space:
            run.discard()  # settings that do not fit these data must not stay with the folder
        raise
    if needs_motion:
        train_motion(run, capture, images, configs["motion"], device)
    return run


def pictures_for(capture: Capture) -> ImageStack | FilePictures:
    """All pictures in memory, each decoded once; of long captures they stay on disk."""
    fit = len(capture) * capture.height * capture.width * 4 <= IN_MEMORY
    return load_images(capture) if fit else FilePictures(capture)


def _check(configs: Mapping[str, Any]) -> None:
    checked_space(configs["space"])
    if "motion" in configs:
        checked_motion(configs["motion"])
    if "paper" in configs:
        base_config(configs["space"], checked_paper(configs["paper"]))


def _train_paper(
    run: Run, capture: Capture, images: ImageStack, configs: Mapping[str, Any], device: str
) -> None:
    """Base Gaussians, space triplane, motion triplanes. space.safetensors is the scene at rest at every stage."""
    config = configs["paper"]
    if not has_model(run):
        views = first_views(capture, images)
        if not run.has_space:
            train_space(run, views, capture.points, base_config(configs["space"], config), device)
        train_triplane(run, run.load_space(), views, config, device)
    model = load_model(run)
    if not run.has_motion:
        run.save_space(model.rest(), {})  # in place of the base Gaussians; the same again after a kill
    if capture.n_timesteps > 1:
        train_timesteps(run, model, capture, images, config, device)
