"""Phase 1 of [TG4MM]: trains space planes, decoder and base attributes on the images of timestep 0."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tg4mm.capture import Capture, ImageStack
from tg4mm.core.memory import peak_memory_mib, reset_peak_memory
from tg4mm.core.progress import Update, progress
from tg4mm.core.work_folder import StageCheckpoint
from tg4mm.fit.device import full_precision, gpu_figures, reset_gpu_peak
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.space import RestViews, rest_views
from tg4mm.fit.space.view import render_view
from tg4mm.research.paper.model import PaperConfig, PaperModel, active, save_model, with_active
from tg4mm.research.paper.triplane import Decoder, base_below, cells_of, new_decoder, sample, scene_box
from tg4mm.run import Run

CHECKPOINT_EVERY_S = 20.0
SHOW_EVERY_S = 0.25
_STAGE = "triplane"
# Gradients of single cells are far below Adam's usual 1e-8, which would slow them down; as in 3D Gaussian Splatting.
_EPS = 1e-15


def views_at(capture: Capture, images: ImageStack, t: int) -> RestViews:
    """Return cameras and pictures of timestep t, over white."""
    rows = np.flatnonzero(capture.timesteps == t)
    return RestViews(
        viewmats=capture.viewmats[rows].astype(np.float32),
        Ks=capture.Ks[rows].astype(np.float32),
        rgb=np.stack([images.rgb(int(i)) for i in rows]).astype(np.float32),
        alpha=np.stack([images.alpha(int(i)) for i in rows]).astype(np.float32),
        images=tuple(np.array([i]) for i in rows),
    )


def first_views(capture: Capture, images: ImageStack) -> RestViews:
    """Return the views of timestep 0, [TG4MM]'s scene at rest, or every picture of a moving camera."""
    return rest_views(capture, images) if capture.kind.moving else views_at(capture, images, 0)


def cameras_on(views: RestViews, device: str) -> Cameras:
    """Return viewmats [V, 4, 4], Ks [V, 3, 3] and pictures [V, H, W, 3] as tensors on the device."""
    a, b, c = (torch.from_numpy(x).to(device) for x in (views.viewmats, views.Ks, views.rgb))
    return a, b, c


def started(base: Gaussians, config: PaperConfig) -> PaperModel:
    """Return the model before phase 1, random planes and heads, with a base that decodes to the Gaussians `base`."""
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
    parameters = {"values": model.values()} | {f"base.{k}": v for k, v in model.base.items()}
    return parameters | {f"decoder.{k}": v for k, v in model.decoder.parameters.items()}


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
    """Train on `views` from the base Gaussians or a checkpoint, and save triplane.safetensors.

    The log's stage `triplane` gets seconds, peak_memory_mib, iterations, l1_train, n_gaussians and sizes.
    """
    kept = StageCheckpoint(run, _STAGE)
    reset_peak_memory()
    reset_gpu_peak(device)
    model = started(base, config)
    cells = cells_of(model.points.numpy(), model.box.numpy(), config.resolution)
    total = config.iterations - config.warm_up
    fit = Fit(_parameters(model), config.learning_rate, total, config.seed, device)
    if (checkpoint := kept.load()) is not None:
        fit.restore(*checkpoint)

    def decoded(p: dict[str, Tensor]) -> Gaussians:
        return Decoder(_group(p, "decoder.")).decode(_group(p, "base."), sample(p["values"], cells))

    with progress("space triplane", total, start=fit.iteration) as update, full_precision(device):
        fit.run(cameras_on(views, device), decoded, kept, update)
    model = _finished(model, fit)
    figures = {
        "peak_memory_mib": peak_memory_mib(),
        **gpu_figures(device),
        "iterations": total,
        "l1_train": float(fit.loss),
        "n_gaussians": len(model.points),
        **model.figures(),
    }
    kept.record(**figures)
    save_model(run, model)
    kept.drop()
    return model


Cameras = tuple[Tensor, Tensor, Tensor]  # viewmats [V, 4, 4], Ks [V, 3, 3], pictures [V, H, W, 3]


class Fit:
    """Named parameters, torch's fused Adam, and a random order of views.

    The rate falls exponentially to `final` times its start; 1: it is fixed.
    """

    def __init__(
        self,
        parameters: Mapping[str, Tensor],
        rate: float,
        iterations: int,
        seed: int,
        device: str = "cpu",
        final: float = 1.0,
    ) -> None:
        self.device, self._rate, self._final, self.iterations = device, rate, final, iterations
        self.parameters = {k: v.detach().clone().to(device).requires_grad_() for k, v in parameters.items()}
        self._adam = torch.optim.Adam(list(self.parameters.values()), lr=rate, eps=_EPS, fused=True)
        self.generator = torch.Generator().manual_seed(seed)
        self.iteration = 0
        self.order: list[int] = []
        self.loss = torch.zeros((), device=device)  # running mean

    def next_view(self, n_views: int) -> int:
        """Return the next view; all are used once, in random order, before any is repeated."""
        if not self.order:
            self.order = torch.randperm(n_views, generator=self.generator).tolist()
        return self.order.pop()

    def step(self, loss: Tensor) -> None:
        loss.backward()
        self._adam.param_groups[0]["lr"] = self._rate * self._final ** (self.iteration / self.iterations)
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)
        now = loss.detach()
        self.loss = now if self.iteration == 0 else 0.95 * self.loss + 0.05 * now
        self.iteration += 1

    def run(
        self,
        cameras: Cameras,
        decoded: Callable[[dict[str, Tensor]], Gaussians],
        kept: StageCheckpoint,
        update: Update,
        before: int = 0,
        **state: int,
    ) -> None:
        """Fit the Gaussians decoded from the parameters to random views, up to the last iteration.

        before: iterations in the progress before this fit. state: entries of progress and checkpoint.
        """
        shown, figure = -math.inf, 0.0
        while self.iteration < self.iterations:
            self.step(view_loss(decoded(self.parameters), cameras, self.next_view(len(cameras[0]))))
            if time.monotonic() - shown > SHOW_EVERY_S:
                shown, figure = time.monotonic(), round(float(self.loss), 5)
            update(before + self.iteration, **state, l1=figure)
            if kept.is_due(CHECKPOINT_EVERY_S):
                kept.save(self.tensors(), self.state() | state)

    def tensors(self) -> dict[str, Tensor]:
        out = {f"p.{k}": v.detach() for k, v in self.parameters.items()}
        for name, p in self.parameters.items():
            state = self._adam.state[p]
            if state:
                out |= {
                    f"m.{name}": state["exp_avg"],
                    f"v.{name}": state["exp_avg_sq"],
                    "step": state["step"],
                }
        return out | {"generator": self.generator.get_state(), "loss": self.loss}

    def state(self) -> dict[str, Any]:
        return {"iteration": self.iteration, "order": self.order}

    def restore(self, tensors: Mapping[str, Tensor], state: Mapping[str, Any]) -> None:
        """Continue from the results of `tensors` and `state`."""
        with torch.no_grad():
            for name, p in self.parameters.items():
                p.copy_(tensors[f"p.{name}"])
                if "step" in tensors:
                    step = tensors["step"].clone()
                    self._adam.state[p] = {
                        "step": step if self.device == "cpu" else step.to(self.device),
                        "exp_avg": tensors[f"m.{name}"].clone().to(self.device),
                        "exp_avg_sq": tensors[f"v.{name}"].clone().to(self.device),
                    }
        self.generator.set_state(tensors["generator"])
        self.loss = tensors["loss"].to(self.device)
        self.iteration, self.order = int(state["iteration"]), list(state["order"])


def view_loss(gaussians: Gaussians, cameras: Cameras, v: int) -> Tensor:
    """Return the mean of |rendered − picture| over the pixels of view v over white, [TG4MM] Eq. (16)."""
    viewmats, Ks, pictures = cameras
    height, width = pictures.shape[1:3]
    view = render_view(gaussians, viewmats[v], Ks[v], (width, height), gaussians.sh_degree)
    return (view.rgb - pictures[v]).abs().mean()
