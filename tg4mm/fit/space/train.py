"""The space stage: static Gaussians fitted to the rest views, with progress and checked checkpoints."""

import hashlib
import json
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tg4mm.capture import SurfacePoints
from tg4mm.core.errors import RunError
from tg4mm.core.memory import peak_memory_mib
from tg4mm.core.progress import progress
from tg4mm.core.values import POSITIVE, Number
from tg4mm.core.work_folder import StageCheckpoint, Stored
from tg4mm.fit.device import full_precision, gpu_figures, reset_gpu_peak
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.space.config import SpaceConfig
from tg4mm.fit.space.density import along_a_curve, control_density, growth, is_due, is_sorting_due
from tg4mm.fit.space.fused import FusedAdam, Iteration
from tg4mm.fit.space.initial import extent_of, initial_points
from tg4mm.fit.space.levels import Level, level_at, levels, resolved, sampled, shrunk, turn_of, work
from tg4mm.fit.space.losses import GAIN_EVERY, fitting_gain, photometric_loss, with_gain
from tg4mm.fit.space.parameters import ParameterAdam, activate, initial_parameters, stride
from tg4mm.fit.space.targets import RestViews, SceneUnit
from tg4mm.fit.space.view import EPS2D, NEAR, render_view

CHECKPOINT_EVERY_S = 20.0
SHOW_EVERY_S = 0.25  # a figure shown is a number fetched from the device, for which the host waits
FUSED = ("cpu",)  # devices on which `fused.py` makes the iterations; on others torch does


@dataclass
class _Fit:
    adam: ParameterAdam | FusedAdam
    error: Tensor  # [N] shares since the last density control
    psnr: Tensor  # [] float64, running mean over training views, dB
    generator: torch.Generator  # on the CPU: the order of the views
    draws: torch.Generator  # on the device: density control; on the CPU the same one
    iteration: int = 0
    order: list[int] = field(default_factory=list)  # views left in this round
    gains: Tensor | None = None  # [V, 3] of the pictures, where they are learnt

    def tensors(self) -> dict[str, Tensor]:
        moments = {f"adam.{k}": v for k, v in self.adam.moments().items()}
        rest = {"error": self.error, "generator": self.generator.get_state()}
        if self.gains is not None:
            rest["gains"] = self.gains
        if self.draws is not self.generator:
            rest["draws"] = self.draws.get_state()
        return {k: v.detach().cpu().contiguous() for k, v in (self.adam.parameters | moments | rest).items()}

    def checkpoint(self, extent: float, pictures: str) -> Stored:
        state = {"iteration": self.iteration, "order": self.order, "psnr": float(self.psnr)}
        return self.tensors(), state | {"extent": extent, "pictures": pictures}


def _draws(generator: torch.Generator, device: str, state: Tensor | None = None) -> torch.Generator:
    """The generator of density control. Without a state (a run that comes from another device) it starts anew."""
    if device == "cpu":
        return generator
    draws = torch.Generator(device).manual_seed(generator.initial_seed())
    if state is not None:
        draws.set_state(state)
    return draws


def _restored(checkpoint: Stored, views: RestViews, device: str) -> tuple[_Fit, float]:
    tensors, state = checkpoint
    generator = torch.Generator()
    generator.set_state(tensors.pop("generator"))
    draws = _draws(generator, device, tensors.pop("draws", None))
    error = tensors.pop("error").to(device)
    gains = tensors.pop("gains").to(device) if "gains" in tensors else None
    psnr = torch.tensor(state["psnr"], dtype=torch.float64, device=device)
    moments = {k.removeprefix("adam."): tensors.pop(k) for k in list(tensors) if k.startswith("adam.")}
    moments = {k: v if k == "step" and device == "cpu" else v.to(device) for k, v in moments.items()}
    adam = _optimiser(tensors, _stride(state["extent"], views), device, moments or None)
    fit = _Fit(adam, error, psnr, generator, draws, state["iteration"], state["order"], gains)
    return fit, state["extent"]


def _stride(extent: float, views: RestViews) -> float:
    return stride(extent, views.rgb.shape[2], views.rgb.shape[1])


def _started(
    views: RestViews, points: SurfacePoints | None, config: SpaceConfig, device: str
) -> tuple[_Fit, float, str]:
    generator = torch.Generator().manual_seed(config.seed)
    count = min(config.init_points, config.max_gaussians)
    first = initial_points(views, points, config.init, count, np.random.default_rng(config.seed))
    extent = extent_of(first.xyz, views)
    parameters = initial_parameters(first, config.sh_degree, generator)
    adam = _optimiser(parameters, _stride(extent, views), device)
    error = torch.zeros(len(first.xyz), device=device)
    psnr = torch.zeros((), dtype=torch.float64, device=device)
    gains = torch.ones(len(views.rgb), 3, device=device) if config.gains else None
    fit = _Fit(adam, error, psnr, generator, _draws(generator, device), gains=gains)
    return fit, extent, first.source


def _optimiser(
    parameters: dict[str, Tensor], stride: float, device: str, moments: dict[str, Tensor] | None = None
) -> ParameterAdam | FusedAdam:
    if device in FUSED:
        return FusedAdam(parameters, stride, moments)
    return ParameterAdam({k: v.to(device) for k, v in parameters.items()}, stride, moments)


class _Views:
    """The cameras and their pictures at one level, where the iterations need them, and an iteration on one of them."""

    def __init__(
        self, views: RestViews, config: SpaceConfig, device: str, shrink: int = 1, spacing: int = 1
    ) -> None:
        """shrink: pixels of `views` across one of this level's. spacing: of those seen at once."""
        views = shrunk(views, shrink)
        self._arrays = (views.viewmats, views.Ks, views.rgb)
        self._tensors = tuple(torch.from_numpy(a).to(device) for a in self._arrays)
        self._config, self._fused = config, Iteration(config.l2, config.dssim)
        self.shrink, self._spacing = shrink, spacing
        self._eps2d = EPS2D / spacing**2  # as wide as in the whole picture
        self.shown = {} if shrink == 1 else {"pictures": f"{shrink} times smaller"}  # beside the progress

    def __len__(self) -> int:
        return len(self._arrays[0])

    def _sampled(self, arrays: tuple, fit: _Fit, v: int) -> tuple:
        """viewmat, K and picture of view v, or the pixels of it whose turn it is."""
        viewmat, K, picture = (a[v] for a in arrays)
        return viewmat, *sampled(
            K, picture, self._spacing, turn_of(v, fit.iteration, len(self), self._spacing)
        )

    def iterate(self, fit: _Fit, v: int, degree: int, done: float) -> Tensor:
        """Render view v, compare, step. Returns the mean squared error."""
        if isinstance(fit.adam, FusedAdam):
            return self._iterate_fused(fit, fit.adam, v, degree, done)
        return self._iterate_torch(fit, fit.adam, v, degree, done)

    def _iterate_fused(self, fit: _Fit, adam: FusedAdam, v: int, degree: int, done: float) -> Tensor:
        viewmat, K, target = self._sampled(self._arrays, fit, v)
        gain = np.ones(3, np.float32) if fit.gains is None else fit.gains[v].numpy()
        pace = float(self.shrink)
        mse = self._fused(adam, viewmat, K, target, degree, done, fit.error.numpy(), gain, pace, self._eps2d)
        if fit.gains is not None:
            fit.gains = with_gain(fit.gains, v, torch.from_numpy(self._fused.fitting_gain(target)))
        return torch.tensor(mse, dtype=torch.float64)

    def _iterate_torch(self, fit: _Fit, adam: ParameterAdam, v: int, degree: int, done: float) -> Tensor:
        viewmat, K, target = self._sampled(self._tensors, fit, v)
        height, width = target.shape[:2]
        view = render_view(activate(adam.parameters), viewmat, K, (width, height), degree, self._eps2d, NEAR)
        shown = view.rgb if fit.gains is None else view.rgb * fit.gains[v]
        target = torch.where(target.isnan(), shown.detach(), target)
        loss = photometric_loss(shown, target, self._config.l2, self._config.dssim)
        difference = shown.detach() - target
        (loss + (view.carrier * difference.abs().sum(-1)).sum()).backward()
        fit.error += view.shares()
        adam.step(done, float(self.shrink))
        if fit.gains is not None:
            every = (slice(None, None, GAIN_EVERY),) * 2
            fit.gains = with_gain(fit.gains, v, fitting_gain(view.rgb.detach()[every], target[every]))
        return (difference**2).mean().double()


def _iterate(fit: _Fit, views: _Views, config: SpaceConfig, level: Level, extent: float) -> None:
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
    if is_due(fit.iteration, level.until):
        most = level.max_gaussians
        share = growth(len(fit.error), most, fit.iteration, level.caught_up)
        control_density(fit.adam, fit.error, extent, most, fit.draws, share)
        if is_sorting_due(fit.iteration, level.until):
            fit.adam.reorder(along_a_curve(fit.adam.parameters["means"].detach()))
        fit.error = torch.zeros(len(fit.adam.parameters["means"]), device=fit.error.device)


@dataclass(frozen=True)
class SpaceFit:
    """The static Gaussians of a scene, on the CPU, and figures of their fit."""

    gaussians: Gaussians
    # seconds, peak_memory_mib, n_gaussians, iterations, psnr_train (dB, running mean of the last views), init (where
    # the fit began; absent after a checkpoint), gains [V, 3] where they are learnt, and on CUDA peak_gpu_memory_mib
    figures: dict[str, Any]


def fit_space(
    views: RestViews,
    points: SurfacePoints | None,
    config: SpaceConfig | None = None,
    device: str = "cpu",
    kept: StageCheckpoint | None = None,
) -> SpaceFit:
    """Fit static Gaussians to the rest views; continue from the checkpoint `kept`, if it has one.

    points: initialisation without SfM, or None. The fit, and what is kept of it, is in the stage's own unit
    (`targets.py`), what is returned in scene units.
    On CUDA everything that an iteration needs lives there, in float32 throughout: rounding of targets or parameters
    to 16 bits would be as large as the differences that the motion stage reads (a fiftieth of a pixel).
    Raises Tg4mmError on settings out of range, CaptureError where there is nothing to start from, RunError where a
    checkpoint is not of these pictures and settings.
    """
    config, kept = resolved(config or SpaceConfig(), views), kept or StageCheckpoint()
    reset_gpu_peak(device)
    unit = SceneUnit.of(views, points)
    views, points = unit.views(views), unit.points(points)
    pictures = pictures_digest(views)
    checkpoint = kept.load(
        lambda tensors, state: check_checkpoint(tensors, state, pictures, len(views.rgb), config)
    )
    start: dict[str, Any] = {}
    if checkpoint is None:
        fit, extent, start["init"] = _started(views, points, config, device)
    else:
        fit, extent = _restored(checkpoint, views, device)
    steps, cameras = levels(config, views.size), None
    shown, figure = -math.inf, 0.0
    with (
        progress("space stage", work(steps, config.iterations), start=work(steps, fit.iteration)) as update,
        full_precision(device),
    ):
        while fit.iteration < config.iterations:
            level = level_at(steps, fit.iteration)
            if cameras is None or cameras.shrink != level.shrink:
                cameras = _Views(views, config, device, level.shrink, level.spacing)
            _iterate(fit, cameras, config, level, extent)
            if time.monotonic() - shown > SHOW_EVERY_S:
                shown, figure = time.monotonic(), round(float(fit.psnr), 2)
            update(work(steps, fit.iteration), psnr_db=figure, gaussians=len(fit.error), **cameras.shown)
            if kept.is_due(CHECKPOINT_EVERY_S):
                kept.save(*fit.checkpoint(extent, pictures), **start)
    gaussians = unit.back(activate(fit.adam.parameters).detach().to("cpu"))
    figures: dict[str, Any] = {
        "seconds": kept.unrecorded_s,
        "peak_memory_mib": peak_memory_mib(),
        **gpu_figures(device),
        "n_gaussians": len(gaussians),
        "iterations": config.iterations,
        "psnr_train": float(fit.psnr),
        **start,
    }
    if fit.gains is not None:
        figures["gains"] = [[round(g, 5) for g in row] for row in fit.gains.tolist()]
    return SpaceFit(gaussians, figures)


def pictures_digest(views: RestViews) -> str:
    """SHA-256 of cameras and pictures."""
    digest = hashlib.sha256(repr(views.rgb.shape).encode())
    for array in (views.viewmats, views.Ks):
        digest.update(np.ascontiguousarray(array).data)
    with progress("digest of the pictures", len(views.rgb), "pictures", brief=True) as update:
        for done, picture in enumerate(views.rgb, 1):
            digest.update(np.ascontiguousarray(picture).data)
            update(done)
    return digest.hexdigest()


def check_checkpoint(
    tensors: Mapping[str, Tensor], state: Mapping[str, Any], pictures: str, n_views: int, config: SpaceConfig
) -> None:
    """Raise RunError, with the first thing wrong, unless the stage can continue from this checkpoint.

    `config` has its zeros filled in; `pictures` is the digest of the n_views pictures.
    """
    if state.get("pictures") != pictures:
        raise RunError("cameras or pictures of the dataset have changed since the checkpoint was written")
    _check_state(state, n_views, config)
    _check_tensors(tensors, state["iteration"], n_views, config)


def _check_state(state: Mapping[str, Any], n_views: int, config: SpaceConfig) -> None:
    order, view = state.get("order"), Number(0, n_views - 1, whole=True)
    good = {
        "iteration": Number(0, config.iterations, whole=True).fits(state.get("iteration")),
        "order": isinstance(order, list) and all(map(view.fits, order)) and len(set(order)) == len(order),
        "psnr": Number().fits(state.get("psnr")),
        "extent": POSITIVE.fits(state.get("extent")),
    }
    for name, is_good in good.items():
        if not is_good:
            text = json.dumps(state.get(name))
            raise RunError(
                f"{name} is {text}, which is not valid for {config.iterations} iterations on {n_views} views"
            )


def _check_tensors(tensors: Mapping[str, Tensor], iteration: int, n_views: int, config: SpaceConfig) -> None:
    """Check names, types and shapes: the kernels would write past arrays that are too short."""
    n = len(tensors["logits"]) if tensors.get("logits", torch.empty(())).dim() == 1 else 0
    if not 1 <= n <= config.max_gaussians:
        raise RunError(f"it holds {n} Gaussians, expected 1 to {config.max_gaussians}")
    expected = _shapes(n, config.sh_degree, stepped=iteration > 0)
    if config.gains:
        expected["gains"] = (n_views, 3)
    found = set(tensors) - {"generator", "draws"}
    if found != set(expected) or "generator" not in tensors:
        raise RunError(f"it holds the tensors {sorted(tensors)}, expected {sorted([*expected, 'generator'])}")
    for name, shape in expected.items():
        tensor = tensors[name]
        if tensor.dtype != torch.float32 or tuple(tensor.shape) != shape:
            raise RunError(f"{name} is {tensor.dtype} {tuple(tensor.shape)}, expected float32 {shape}")
    try:
        torch.Generator().set_state(tensors["generator"])
    except (RuntimeError, TypeError) as error:
        raise RunError(f"generator is no state of a random generator: {error}") from None


def _shapes(n: int, sh_degree: int, stepped: bool) -> dict[str, tuple[int, ...]]:
    """Shapes of the tensors but the generators; Adam has moments once it has stepped."""
    parameters: dict[str, tuple[int, ...]] = {
        "means": (n, 3),
        "quats": (n, 4),
        "log_scales": (n, 3),
        "logits": (n,),
        "sh0": (n, 1, 3),
        "shn": (n, (sh_degree + 1) ** 2 - 1, 3),
    }
    moments = {f"adam.{name}.{kind}": shape for name, shape in parameters.items() for kind in "mv"}
    return parameters | {"error": (n,)} | (moments | {"adam.step": ()} if stepped else {})
