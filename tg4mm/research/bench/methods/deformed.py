"""Runs that move the Gaussians of `modal` (same space stage, same settings) by another method.

Trajectories are kept as a modal motion of all frequency bins, so that the band is magnified as for other methods.
"""

import dataclasses
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from tg4mm.capture import Capture, ImageStack, load_capture, load_images
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.memory import peak_memory_mib, reset_peak_memory
from tg4mm.core.phasors import series_modes
from tg4mm.core.progress import progress
from tg4mm.fit.device import full_precision, gpu_figures, reset_gpu_peak
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.animate import moved
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.space import rest_views
from tg4mm.research.bench.methods import Trained
from tg4mm.research.bench.request import Scoring, Training
from tg4mm.research.paper.space import Cameras, cameras_on, view_loss, views_at
from tg4mm.research.paper.space import Fit as Fitting
from tg4mm.research.paper.triplane import base_of, scene_box
from tg4mm.run import Run
from tg4mm.run.stages import train_space
from tg4mm.run.train import parse_settings

_MAY_BE_ZERO = ("smoothness", "seed", "margin", "stiffness")


C = TypeVar("C")

# 4DGS's rates for its Gaussians; a tenth is used, since these are fitted already. Means per unit of the box.
_RATES = {"means": 1.6e-4, "quats": 1e-3, "log_scales": 5e-3, "logits": 5e-2, "sh": 2.5e-3}
PER_FRAME = "per-frame"


def configured(name: str, usual: C, given: Mapping[str, str]) -> C:
    """Return `usual` with the settings `NAME.KEY`. Raises Tg4mmError for an unknown one, and an invalid value."""
    names = [f"{name}.{f.name}" for f in dataclasses.fields(usual)]  # type: ignore[arg-type]
    for key in given:
        if key not in names:
            raise Tg4mmError(f"--set {key}: {name} has {', '.join(names)}")
    values = {k.partition(".")[2]: _number(k, v, usual) for k, v in given.items()}
    return dataclasses.replace(usual, **values)  # type: ignore[type-var]


def overrides(name: str, config: Any, usual: Any) -> dict[str, str]:
    """Return the settings that differ from the usual ones, as `--set` takes them."""
    before = dataclasses.asdict(usual)
    return {f"{name}.{k}": str(v) for k, v in dataclasses.asdict(config).items() if v != before[k]}


def _number(name: str, text: str, usual: Any) -> Any:
    kind = type(getattr(usual, name.partition(".")[2]))
    try:
        value = kind(text)
    except ValueError:
        value = -1
    least = 0 if name.endswith(_MAY_BE_ZERO) else 1 if kind is int else 1e-12
    if not least <= value < 1e9:
        raise Tg4mmError(f"setting {name} is {text!r}, expected {kind.__name__} of at least {least:g}")
    return value


@dataclass(frozen=True)
class Moving:
    """The result of a method: Gaussians at rest, and their displacement and rotation vectors [T, N, 6].

    Displacements are in scene units, rotation vectors in radians.
    """

    gaussians: Gaussians
    series: Tensor
    iterations: int
    parameters: int


# (the Gaussians of `modal`, the views of each timestep, its configuration) → fitted motion
Fit = Callable[[Gaussians, list[Cameras], Any], Moving]


@dataclass(frozen=True)
class Deformer:
    """A `Trainer`: the space stage of `modal`, then a method's fit to the pictures of all timesteps."""

    name: str
    usual: Any  # its configuration by default
    fit: Fit
    config: Any

    def plain(self) -> dict[str, Any]:
        return {self.name: dataclasses.asdict(self.config)}

    def overrides(self) -> dict[str, str]:
        return overrides(self.name, self.config, self.usual)

    def __call__(self, dataset: Path, place: Path, settings: Mapping[str, str], device: str) -> Run:
        configs = parse_settings(settings, "modal")
        plain = {stage: dataclasses.asdict(config) for stage, config in configs.items()}
        run = Run.create(place, dataset, "modal", plain | self.plain())
        if run.has_space and run.has_motion:
            return run
        capture = load_capture(dataset)
        images = load_images(capture)
        if not run.has_space:
            train_space(run, rest_views(capture, images), capture.points, configs["space"], device)
        fit_motion(run, capture, images, self.fit, self.config, device)
        return run


def deformed(name: str, usual: Any, fit: Fit, settings: Mapping[str, str], own: Mapping[str, str]) -> Trained:
    """Return the method; `settings`: those of `modal`, for the space stage; `own`: `NAME.…`."""
    deformer = Deformer(name, usual, fit, configured(name, usual, own))
    return Trained(Training(name, "modal", settings, (Scoring(name, "modal"),), deformer))


def fit_motion(
    run: Run, capture: Capture, images: ImageStack, fit: Fit, config: Any, device: str = "cpu"
) -> None:
    """Fit to all pictures and save the run's motion. A killed fit starts again."""
    began = time.monotonic()
    reset_peak_memory()
    reset_gpu_peak(device)
    g = run.load_space().to(device)
    views = [cameras_on(views_at(capture, images, t), "cpu") for t in range(capture.n_timesteps)]
    with full_precision(device):
        found = fit(g, views, config)
    freqs, phasors = series_modes(found.series.cpu().numpy(), capture.fps)
    motion = ModalMotion.of_phasors(
        freqs, phasors[..., :3], phasors[..., 3:], capture.fps, capture.n_timesteps
    )
    if found.gaussians is not g:
        run.save_space(found.gaussians, {})
    figures = {"iterations": found.iterations, "parameters": found.parameters, **gpu_figures(device)}
    spent = {"seconds": time.monotonic() - began, "peak_memory_mib": peak_memory_mib()}
    run.save_motion(motion, spent | figures)


def box_of(g: Gaussians) -> Tensor:
    """Return the box of the Gaussians [2, 3], scene units."""
    return torch.from_numpy(scene_box(g.means.cpu().numpy()).astype(np.float32)).to(g.means.device)


Group = dict[str, Any]  # of Adam: {params, lr}


def descend(
    name: str,
    now: Callable[[], Gaussians],
    motion: Callable[[int], Tensor],
    penalty: Callable[[int], Tensor],
    groups: Iterable[Group],
    views: list[Cameras],
    iterations: int,
    seed: int,
) -> None:
    """Fit to random views of random timesteps; Adam's rates fall to a tenth.

    now: the Gaussians at rest. motion: [N, 6] of a timestep. penalty: added to the L1 of its pictures.
    """
    adam = torch.optim.Adam(list(groups), eps=1e-15)
    falls = torch.optim.lr_scheduler.ExponentialLR(adam, 0.1 ** (1 / iterations))
    draw = np.random.default_rng(seed)
    with progress(name, iterations) as update:
        for i in range(iterations):
            t = int(draw.integers(len(views)))
            v = int(draw.integers(len(views[t][0])))
            posed = moved(now(), motion(t))
            viewmats, ks, pictures = (x[v : v + 1].to(posed.means.device) for x in views[t])
            (view_loss(posed, (viewmats, ks, pictures), 0) + penalty(t)).backward()
            adam.step()
            falls.step()
            adam.zero_grad(set_to_none=True)
            update(i + 1)


class Free:
    """Gaussians with trained attributes."""

    def __init__(self, g: Gaussians) -> None:
        self.parameters = {k: v.requires_grad_() for k, v in base_of(g).items()}
        box = box_of(g)
        unit = {"means": float((box[1] - box[0]).max())}
        self.groups: list[Group] = [
            {"params": [p], "lr": 0.1 * _RATES[k] * unit.get(k, 1.0)} for k, p in self.parameters.items()
        ]

    def now(self) -> Gaussians:
        p = self.parameters
        return Gaussians(p["means"], p["quats"], p["log_scales"].exp(), p["logits"].sigmoid(), p["sh"])


@torch.no_grad()
def from_first(g: Gaussians, motion: Callable[[int], Tensor], n: int) -> tuple[Gaussians, Tensor]:
    """Return the Gaussians at timestep 0 and the motion from there [n, N, 6]; small rotations are subtracted."""
    series = torch.stack([motion(t) for t in range(n)])
    return moved(g.detach(), series[0]), series - series[0]


@dataclass(frozen=True)
class PerFrameConfig:
    """Settings: positions and rotations are tuned, and the rate falls to `falls_to` within a timestep."""

    iterations: int = 100  # of each timestep, one view each
    rate: float = 2e-4  # of Adam; of displacements per unit of the scene's box
    falls_to: float = 0.03
    seed: int = 0


def tune_each(g: Gaussians, views: list[Cameras], config: PerFrameConfig) -> Moving:
    """Fit each timestep's motion separately, from zero."""
    box, n = box_of(g), config.iterations
    unit = torch.tensor([float((box[1] - box[0]).max())] * 3 + [1.0] * 3, device=g.means.device)
    series = []
    with progress(PER_FRAME, len(views) * n) as update:
        for t, (viewmats, ks, pictures) in enumerate(views):
            cameras = viewmats.to(unit.device), ks.to(unit.device), pictures.to(unit.device)
            zero = {"motion": torch.zeros(len(g), 6)}
            fit = Fitting(zero, config.rate, n, config.seed + t, str(unit.device), config.falls_to)
            while fit.iteration < n:
                posed = moved(g, fit.parameters["motion"] * unit)
                fit.step(view_loss(posed, cameras, fit.next_view(len(pictures))))
                update(t * n + fit.iteration)
            series.append((fit.parameters["motion"] * unit).detach())
    return Moving(g, torch.stack(series), len(views) * n, 6 * len(g))
