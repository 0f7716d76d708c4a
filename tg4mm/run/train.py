"""Training from a dataset to a run folder: settings, then the stages of the preset, space before motion."""

import dataclasses
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tg4mm.capture import Capture, load_capture, transforms
from tg4mm.capture.cameras import check_depth_observable, check_picture_size
from tg4mm.capture.readers import READERS
from tg4mm.capture.transforms import train_command, whole_dataset
from tg4mm.core.errors import CaptureError, Tg4mmError
from tg4mm.core.options import unknown
from tg4mm.fit.device import check_device
from tg4mm.fit.motion.config import asked_band
from tg4mm.fit.motion.observations import check_band_resolved, check_shows_motion
from tg4mm.run import Run
from tg4mm.run.folder import work_folder
from tg4mm.run.preset import asked_masks, preset_named

_LOG = logging.getLogger("tg4mm")
_BOOLEANS = {"true": True, "false": False}


def parse_settings(pairs: Mapping[str, str], preset: str = "modal") -> dict[str, Any]:
    """Return the configurations of all stages of a preset from `{"space.iterations": "3000", …}`.

    Raises Tg4mmError for an unknown name, with similar ones, and for a value of the wrong type.
    """
    defaults = preset_named(preset).defaults
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

    Complete stages are skipped, an unfinished one continues from its checkpoint. A capture of one timestep ends after
    the space stage. settings: `{"space.iterations": "3000", …}`.
    Raises Tg4mmError (CaptureError, RunError) on bad input, and RunError while another process trains the run.
    """
    chosen = preset_named(preset)
    check_device(device)
    configs = parse_settings(settings or {}, preset)
    # before the run folder exists, which would keep the bad value, and before minutes of the space stage
    chosen.check(configs)
    capture = _capture(Path(dataset))
    if preset == "modal":
        asked_masks(capture, configs)  # before minutes of the space stage
    if capture.n_timesteps > 1 and "motion" in configs:
        check_shows_motion(capture)
        if (band := asked_band(getattr(configs["motion"], "band", ""), capture.fps)) is not None:
            check_band_resolved(band, capture.n_timesteps / capture.fps)
    with work_folder(run_path).locked("trains it"):
        return _train(Path(run_path), capture, preset, configs, device)


def _capture(dataset: Path) -> Capture:
    """Load the capture of a dataset. A video or pictures raise CaptureError with the command that makes a dataset.

    A dataset of one timestep is a still scene, which may be intended, and gives a warning.
    """
    if (part := whole_dataset(dataset)) is not None:
        root, what = part
        if dataset.resolve().parent != root or not transforms.recognises(dataset):
            raise CaptureError(f"{dataset}: is not a dataset but {what}; run {train_command(root)}")
        _LOG.warning(f"{dataset}: is {what}, by itself a still scene; with its motion: {train_command(root)}")
    if dataset.is_file() or (dataset.is_dir() and not any(reader.recognises(dataset) for reader in READERS)):
        from tg4mm.capture.sfm.clip import suggested_command

        if (command := suggested_command(dataset)) is not None:
            raise CaptureError(f"{dataset}: is no dataset yet; make one with: {command}")
    capture = load_capture(dataset, split="train")
    if capture.kind.sees_depth:
        check_depth_observable(capture.root, capture.viewmats, capture.camera_ids)
    check_picture_size(dataset, capture.width, capture.height)
    return capture


def _train(run_path: Path, capture: Capture, preset: str, configs: dict[str, Any], device: str) -> Run:
    """Run the unfinished stages."""
    # unset texts are left out, so that a run of a version without that setting is the same request
    plain = {
        stage: {k: v for k, v in dataclasses.asdict(config).items() if v != ""}
        for stage, config in configs.items()
    }
    is_new = not (run_path / "config.json").exists()
    run = Run.create(run_path, capture.root, preset, plain)
    chosen = preset_named(preset)
    if run.has_space and (run.has_motion or capture.n_timesteps == 1) and chosen.is_complete(run):
        return run
    try:
        chosen.fit(run, capture, configs, device)
    except Tg4mmError:
        if is_new and not run.has_space:
            run.discard()  # settings that do not fit these data must not stay with the folder
        raise
    return run
