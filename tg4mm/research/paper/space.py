"""Phase 1 of [TG4MM]: space planes, decoder and base attributes trained together on the images of timestep 0."""

from __future__ import annotations

import math
import time

import numpy as np
import torch

from tg4mm.capture import Capture, ImageStack
from tg4mm.core.memory import peak_memory_mib, reset_peak_memory
from tg4mm.core.progress import progress
from tg4mm.fit.device import full_precision, gpu_figures, reset_gpu_peak
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.space import RestViews
from tg4mm.research.paper.config import PaperConfig
from tg4mm.research.paper.fit import Cameras, Fit, view_loss
from tg4mm.research.paper.model import PaperModel, active, save_model, with_active
from tg4mm.research.paper.triplane import Decoder, cells_of, new_decoder, sample
from tg4mm.research.paper.triplane.cells import scene_box
from tg4mm.research.paper.triplane.decoder import base_below
from tg4mm.run import Run

CHECKPOINT_EVERY_S = 20.0
SHOW_EVERY_S = 0.25
_STAGE = "triplane"


def views_at(capture: Capture, images: ImageStack, t: int) -> RestViews:
    """The cameras and pictures of timestep t, over white."""
    rows = np.flatnonzero(capture.timesteps == t)
    return RestViews(
        viewmats=capture.viewmats[rows].astype(np.float32),
        Ks=capture.Ks[rows].astype(np.float32),
        rgb=np.stack([images.rgb(int(i)) for i in rows]).astype(np.float32),
        alpha=np.stack([images.alpha(int(i)) for i in rows]).astype(np.float32),
        images=tuple(np.array([i]) for i in rows),
    )


def first_views(capture: Capture, images: ImageStack) -> RestViews:
    """Those of timestep 0, which [TG4MM] takes for the scene at rest."""
    return views_at(capture, images, 0)


def cameras_on(views: RestViews, device: str) -> Cameras:
    a, b, c = (torch.from_numpy(x).to(device) for x in (views.viewmats, views.Ks, views.rgb))
    return a, b, c


def started(base: Gaussians, config: PaperConfig) -> PaperModel:
    """The model before phase 1: random planes and heads, on a base from which they decode to the Gaussians `base`."""
    generator = torch.Generator().manual_seed(config.seed)
    shape = (3, config.channels, config.resolution, config.resolution)
    planes = torch.randn(shape, generator=generator) * config.deviation
    n_sh = base.sh.shape[1]
    decoder = new_decoder(3 * config.channels, n_sh, config.mlp_layers, config.mlp_width, generator)
    points = base.means.clone()
    box = torch.from_numpy(scene_box(points.numpy()))
    cells = cells_of(points.numpy(), box.numpy(), config.resolution)
    below = base_below(base, decoder, sample(active(planes, cells), cells))
    return PaperModel(planes, points, box, below, decoder, config.residual)


def _parameters(model: PaperModel) -> dict[str, torch.Tensor]:
    own = {"values": model.values()} | {f"base.{k}": v for k, v in model.base.items()}
    return own | {f"decoder.{k}": v for k, v in model.decoder.parameters.items()}


def _group(parameters: dict[str, torch.Tensor], prefix: str) -> dict[str, torch.Tensor]:
    return {k.removeprefix(prefix): v for k, v in parameters.items() if k.startswith(prefix)}


def _finished(model: PaperModel, fit: Fit) -> PaperModel:
    final = {k: v.detach().cpu() for k, v in fit.parameters.items()}
    return PaperModel(
        with_active(model.planes, model.cells, final["values"]), model.points, model.box,
        _group(final, "base."), Decoder(_group(final, "decoder.")), model.residual,
    )  # fmt: skip


def train_triplane(
    run: Run, base: Gaussians, views: RestViews, config: PaperConfig, device: str = "cpu"
) -> PaperModel:
    """Train on `views` from the base Gaussians, save triplane.safetensors, go on from a checkpoint if there is one.

    The log's stage `triplane` gets seconds, peak_memory_mib, iterations, l1_train, n_gaussians and sizes.
    """
    began = time.monotonic()
    reset_peak_memory()
    reset_gpu_peak(device)
    model = started(base, config)
    cells = cells_of(model.points.numpy(), model.box.numpy(), config.resolution)
    total = config.iterations - config.warm_up
    fit = Fit(_parameters(model), config.learning_rate, total, config.seed, device)
    if (checkpoint := run.load_checkpoint(_STAGE)) is not None:
        fit.restore(*checkpoint)
    cameras = cameras_on(views, device)
    saved, shown, figure = time.monotonic(), -math.inf, 0.0
    with progress("space triplane", total, start=fit.iteration) as update, full_precision(device):
        while fit.iteration < total:
            p = fit.parameters
            embedding = sample(p["values"], cells)
            gaussians = Decoder(_group(p, "decoder.")).decode(_group(p, "base."), embedding)
            fit.step(view_loss(gaussians, cameras, fit.next_view(len(views.rgb))))
            if time.monotonic() - shown > SHOW_EVERY_S:
                shown, figure = time.monotonic(), round(float(fit.loss), 5)
            update(fit.iteration, l1=figure)
            if time.monotonic() - saved > CHECKPOINT_EVERY_S:
                run.save_checkpoint(_STAGE, fit.tensors(), fit.state())
                saved = time.monotonic()
                run.record(_STAGE, {"seconds": saved - began})
                began = saved
    model = _finished(model, fit)
    figures = {
        "seconds": time.monotonic() - began,
        "peak_memory_mib": peak_memory_mib(),
        **gpu_figures(device),
        "iterations": total,
        "l1_train": float(fit.loss),
        "n_gaussians": len(model.points),
        **model.figures(),
    }
    run.record(_STAGE, figures)
    save_model(run, model)
    run.drop_checkpoint(_STAGE)
    return model


__all__ = ["active", "cameras_on", "first_views", "started", "train_triplane", "views_at"]
