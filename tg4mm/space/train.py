"""The space stage: fit static Gaussians to the rest views, with checkpoints and progress."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tg4mm.capture import SurfacePoints
from tg4mm.capture.geometry import optical_axes
from tg4mm.device import full_precision, gpu_figures, reset_gpu_peak
from tg4mm.errors import RunError, Tg4mmError
from tg4mm.gaussians import Gaussians
from tg4mm.memory import peak_memory_mib
from tg4mm.progress import progress
from tg4mm.runs import Run
from tg4mm.space.checkpoint import check_checkpoint, pictures_digest
from tg4mm.space.config import MOST_GAUSSIANS, MOST_ITERATIONS, SpaceConfig
from tg4mm.space.density import control_density, growth, is_due
from tg4mm.space.fused import FusedAdam, Iteration
from tg4mm.space.initial import INITS, initial_points, working_box
from tg4mm.space.losses import photometric_loss
from tg4mm.space.parameters import ParameterAdam, activate, initial_parameters, stride
from tg4mm.space.targets import RestViews
from tg4mm.space.view import render_view

CHECKPOINT_EVERY_S = 20.0
SHOW_EVERY_S = 0.25  # a figure shown is a number fetched from the device, for which the host waits
FUSED = ("cpu",)  # devices on which `fused.py` makes the iterations; on others torch does
_STAGE = "space"


def checked(config: SpaceConfig) -> SpaceConfig:
    """`config`. Raises Tg4mmError on a value out of range."""
    checks = {
        "iterations": (0 <= config.iterations <= MOST_ITERATIONS, f"0 to {MOST_ITERATIONS:,}"),
        "max_gaussians": (
            config.max_gaussians == 0 or 4 <= config.max_gaussians <= MOST_GAUSSIANS,
            f"0, or 4 to {MOST_GAUSSIANS:,}",
        ),
        "sh_degree": (0 <= config.sh_degree <= 3, "0 to 3"),
        "l2": (math.isfinite(config.l2) and config.l2 >= 0, ">= 0"),
        "dssim": (0 <= config.dssim <= 1, "0 to 1"),
        "init": (config.init in INITS, ", ".join(INITS)),
        "init_points": (4 <= config.init_points <= MOST_GAUSSIANS, f"4 to {MOST_GAUSSIANS:,}"),
        "seed": (0 <= config.seed < 1 << 63, "0 to 2⁶³ − 1"),
    }
    for name, (good, expected) in checks.items():
        if not good:
            raise Tg4mmError(f"setting space.{name} is {getattr(config, name)}, expected {expected}")
    return config


def resolved(config: SpaceConfig, views: RestViews) -> SpaceConfig:
    """The settings with what follows from the data filled in. Raises Tg4mmError on a value out of range."""
    config = checked(config)
    covered = float(views.alpha.sum() / len(views.alpha))
    iterations = int(np.clip(150 * covered ** (1 / 3), 1_000, 30_000))
    most = int(np.clip(200 * math.sqrt(covered), 2_000, 500_000))
    return replace(
        config,
        iterations=config.iterations or iterations,
        max_gaussians=config.max_gaussians or most,
    )


@dataclass
class _Fit:
    """Everything that changes from one iteration to the next."""

    adam: ParameterAdam | FusedAdam
    error: Tensor  # [N] shares since the last density control
    psnr: Tensor  # [] float64, running mean over training views, dB
    generator: torch.Generator  # on the CPU: the order of the views
    draws: torch.Generator  # on the device: density control; on the CPU the same one
    iteration: int = 0
    order: list[int] = field(default_factory=list)  # views left in this round

    def tensors(self) -> dict[str, Tensor]:
        moments = {f"adam.{k}": v for k, v in self.adam.moments().items()}
        rest = {"error": self.error, "generator": self.generator.get_state()}
        if self.draws is not self.generator:
            rest["draws"] = self.draws.get_state()
        return {k: v.detach().cpu().contiguous() for k, v in (self.adam.parameters | moments | rest).items()}

    def save(self, run: Run, extent: float, pictures: str) -> None:
        tensors = self.tensors()
        state = {"iteration": self.iteration, "order": self.order, "psnr": float(self.psnr)}
        run.save_checkpoint(_STAGE, tensors, state | {"extent": extent, "pictures": pictures})


def _draws(generator: torch.Generator, device: str, state: Tensor | None = None) -> torch.Generator:
    """The generator of density control. Without a state (a run that comes from another device) it starts anew."""
    if device == "cpu":
        return generator
    draws = torch.Generator(device).manual_seed(generator.initial_seed())
    if state is not None:
        draws.set_state(state)
    return draws


def _checkpoint(
    run: Run, pictures: str, views: RestViews, config: SpaceConfig
) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
    """What the stage goes on from, None if it starts. Raises RunError if that cannot be."""
    checkpoint = run.load_checkpoint(_STAGE)
    if checkpoint is not None:
        try:
            check_checkpoint(*checkpoint, pictures, len(views.rgb), config)
        except RunError as error:
            file = run.part_file(f"checkpoint_{_STAGE}")
            raise RunError(f"{file}: {error}; delete it to start the {_STAGE} stage again") from None
    return checkpoint


def _restored(
    checkpoint: tuple[dict[str, Tensor], dict[str, Any]], views: RestViews, device: str
) -> tuple[_Fit, float]:
    tensors, state = checkpoint
    generator = torch.Generator()
    generator.set_state(tensors.pop("generator"))
    draws = _draws(generator, device, tensors.pop("draws", None))
    error = tensors.pop("error").to(device)
    psnr = torch.tensor(state["psnr"], dtype=torch.float64, device=device)
    moments = {k.removeprefix("adam."): tensors.pop(k) for k in list(tensors) if k.startswith("adam.")}
    moments = {k: v if k == "step" and device == "cpu" else v.to(device) for k, v in moments.items()}
    adam = _optimiser(tensors, _stride(state["extent"], views), device, moments or None)
    return _Fit(adam, error, psnr, generator, draws, state["iteration"], state["order"]), state["extent"]


def _extent(xyz: np.ndarray, views: RestViews) -> float:
    """How far the points [M, 3] reach from their middle, scene units; at most what the cameras see together.

    Cameras at one place see no distance, and set no limit.
    """
    reach = float(np.linalg.norm(xyz - xyz.mean(0), axis=1).max())
    origins, _ = optical_axes(views.viewmats)
    if np.ptp(origins, axis=0).max() <= 1e-6 * max(reach, 1e-6):
        return reach or 1.0
    return min(reach, 2 * working_box(views)[1]) or 1.0


def _stride(extent: float, views: RestViews) -> float:
    return stride(extent, views.rgb.shape[2], views.rgb.shape[1])


def _started(
    views: RestViews, points: SurfacePoints | None, config: SpaceConfig, device: str
) -> tuple[_Fit, float, str]:
    generator = torch.Generator().manual_seed(config.seed)
    count = min(config.init_points, config.max_gaussians)
    first = initial_points(views, points, config.init, count, np.random.default_rng(config.seed))
    extent = _extent(first.xyz, views)
    parameters = initial_parameters(first, config.sh_degree, generator)
    adam = _optimiser(parameters, _stride(extent, views), device)
    error = torch.zeros(len(first.xyz), device=device)
    psnr = torch.zeros((), dtype=torch.float64, device=device)
    return _Fit(adam, error, psnr, generator, _draws(generator, device)), extent, first.source


def _optimiser(
    parameters: dict[str, Tensor], stride: float, device: str, moments: dict[str, Tensor] | None = None
) -> ParameterAdam | FusedAdam:
    if device in FUSED:
        return FusedAdam(parameters, stride, moments)
    return ParameterAdam({k: v.to(device) for k, v in parameters.items()}, stride, moments)


class _Views:
    """The cameras and their pictures where the iterations need them, and one iteration on one of them."""

    def __init__(self, views: RestViews, config: SpaceConfig, device: str) -> None:
        self._arrays = (views.viewmats, views.Ks, views.rgb)
        self._tensors = tuple(torch.from_numpy(a).to(device) for a in self._arrays)
        self._config, self._fused = config, Iteration(config.l2, config.dssim)

    def __len__(self) -> int:
        return len(self._arrays[0])

    def iterate(self, fit: _Fit, v: int, degree: int, done: float) -> Tensor:
        """Render view v, compare, step. Returns the mean squared error."""
        if isinstance(fit.adam, FusedAdam):
            viewmat, K, target = (a[v] for a in self._arrays)
            mse = self._fused(fit.adam, viewmat, K, target, degree, done, fit.error.numpy())
            return torch.tensor(mse, dtype=torch.float64)
        return self._iterate_torch(fit.adam, fit.error, v, degree, done)

    def _iterate_torch(self, adam: ParameterAdam, error: Tensor, v: int, degree: int, done: float) -> Tensor:
        viewmat, K, target = (a[v] for a in self._tensors)
        height, width = target.shape[:2]
        view = render_view(activate(adam.parameters), viewmat, K, (width, height), degree)
        loss = photometric_loss(view.rgb, target, self._config.l2, self._config.dssim)
        difference = view.rgb.detach() - target
        (loss + (view.carrier * difference.abs().sum(-1)).sum()).backward()
        error += view.shares()
        adam.step(done)
        return (difference**2).mean().double()


def _iterate(fit: _Fit, views: _Views, config: SpaceConfig, extent: float) -> None:
    """One view: render, compare, step; and now and then density control.

    But for density control nothing here waits for the device (gsplat does, once in a render, for the number of
    its tile pairs).
    """
    if not fit.order:
        fit.order = torch.randperm(len(views), generator=fit.generator).tolist()
    v = fit.order.pop()
    done = fit.iteration / config.iterations
    degree = min(config.sh_degree, int(10 * done))
    psnr = -10 * torch.log10(views.iterate(fit, v, degree, done).clamp_min(1e-10))
    fit.psnr = psnr if fit.iteration == 0 else 0.95 * fit.psnr + 0.05 * psnr
    fit.iteration += 1
    if is_due(fit.iteration, config.iterations):
        most = config.max_gaussians
        share = growth(len(fit.error), most, fit.iteration, config.iterations)
        control_density(fit.adam, fit.error, extent, most, fit.draws, share)
        fit.error = torch.zeros(len(fit.adam.parameters["means"]), device=fit.error.device)


def train_space(
    run: Run, views: RestViews, points: SurfacePoints | None, config: SpaceConfig, device: str = "cpu"
) -> Gaussians:
    """Fit static Gaussians to the rest views and save them in the run; go on from a checkpoint if there is one.

    points: initialisation without SfM, or None. Returns the Gaussians (on the CPU). The run's log gets seconds,
    peak_memory_mib, n_gaussians, iterations, init and psnr_train (dB, running mean of the last views).
    On CUDA everything that an iteration needs lives there, in float32 throughout: rounding of targets or parameters
    to 16 bits would be as large as the differences that the motion stage reads (a fiftieth of a pixel).
    Raises Tg4mmError on settings out of range, CaptureError where there is nothing to start from, RunError where a
    checkpoint is not this stage's on these pictures.
    """
    config = resolved(config, views)
    reset_gpu_peak(device)
    pictures = pictures_digest(views)
    checkpoint = _checkpoint(run, pictures, views, config)
    began = time.monotonic()
    if checkpoint is None:
        fit, extent, source = _started(views, points, config, device)
        run.record(_STAGE, {"init": source})
    else:
        fit, extent = _restored(checkpoint, views, device)
    cameras = _Views(views, config, device)
    saved = time.monotonic()
    shown, figure = -math.inf, 0.0
    with (
        progress("space stage", config.iterations, start=fit.iteration) as update,
        full_precision(device),
    ):
        while fit.iteration < config.iterations:
            _iterate(fit, cameras, config, extent)
            if time.monotonic() - shown > SHOW_EVERY_S:
                shown, figure = time.monotonic(), round(float(fit.psnr), 2)
            update(fit.iteration, psnr_db=figure, gaussians=len(fit.error))
            if time.monotonic() - saved > CHECKPOINT_EVERY_S:
                fit.save(run, extent, pictures)
                saved = time.monotonic()
                run.record(_STAGE, {"seconds": saved - began})
                began = saved
    gaussians = activate(fit.adam.parameters).detach().to("cpu")
    figures = {
        "seconds": time.monotonic() - began,
        "peak_memory_mib": peak_memory_mib(),
        **gpu_figures(device),
        "n_gaussians": len(gaussians),
        "iterations": config.iterations,
        "psnr_train": float(fit.psnr),
    }
    run.save_space(gaussians, figures)
    run.drop_checkpoint(_STAGE)
    return gaussians
