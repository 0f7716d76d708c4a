"""The presets `paper` and `paper-tuned`, as the entry point `tg4mm.methods` gives them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from tg4mm.capture import Capture, load_images
from tg4mm.core.magnification import Magnification
from tg4mm.fit.space import SpaceConfig
from tg4mm.fit.space.config import checked as checked_space
from tg4mm.research.paper.config import PAPER, PAPER_TUNED, base_config, checked
from tg4mm.research.paper.embeddings import series_of
from tg4mm.research.paper.model import has_model, load_model
from tg4mm.research.paper.motion import train_timesteps
from tg4mm.research.paper.space import first_views, train_triplane
from tg4mm.run import Run
from tg4mm.run.preset import Poses, Preset
from tg4mm.run.stages.space import train_space


def _check(configs: Mapping[str, Any]) -> None:
    checked_space(configs["space"])
    base_config(configs["space"], checked(configs["paper"]))


def _fit(run: Run, capture: Capture, configs: Mapping[str, Any], device: str) -> None:
    """Base Gaussians, space triplane, motion triplanes. space.safetensors is the scene at rest at every stage."""
    config, images = configs["paper"], load_images(capture)
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


def _poses(run: Run, method: str, plan: Magnification, device: str) -> Poses:
    series = series_of(run, method, plan, device)
    return Poses(series.at, series.n_timesteps, series.fps)


PRESET = Preset(
    # `space` is the fit of the base Gaussians, by L1
    defaults={"space": SpaceConfig(l2=0.0), "paper": PAPER},
    methods=("phase", "linear", "modal"),
    check=_check,
    is_complete=has_model,
    fit=_fit,
    poses=_poses,
)
TUNED = replace(
    PRESET, defaults={**PRESET.defaults, "paper": PAPER_TUNED}, methods=("linear", "phase", "modal")
)
