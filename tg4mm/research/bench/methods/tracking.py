"""Gaussians tracked through the frames, in the manner of 4DGS: the dynamic 3DGS that [TG4MM] Table V compares with.

The Gaussians at rest are those of `modal` (same space stage, same settings), and stay as they are; a `HexPlane` that is
trained on the pictures of all timesteps moves them. Departures from the published 4DGS: Gaussians are not trained
along, size and opacity do not change, and the time planes have a cell for each timestep. The trajectories are kept as a
modal motion of all frequency bins, so that the band is magnified as by any other method.
"""

import dataclasses
import time
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import grid_sample

from tg4mm.capture import Capture, ImageStack, load_capture, load_images
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.memory import peak_memory_mib, reset_peak_memory
from tg4mm.core.phasors import series_modes
from tg4mm.core.progress import progress
from tg4mm.fit.device import full_precision, gpu_figures, reset_gpu_peak
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.animate import rotated
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.space import rest_views
from tg4mm.research.bench.methods import Trained
from tg4mm.research.bench.request import Scoring, Training
from tg4mm.research.paper.space import Cameras, cameras_on, view_loss, views_at
from tg4mm.research.paper.triplane import scene_box
from tg4mm.run import Run
from tg4mm.run.stages.space import train_space
from tg4mm.run.train import parse_settings

NAME = "tracking"


@dataclass(frozen=True)
class TrackingConfig:
    """Settings of the deformation field, after 4DGS's for synthetic scenes.

    Other than there: fewer iterations, smoothness of planes 2e-4 and over time 1e-3 (1e-4 and 1e-2), no L1 on planes,
    rates that fall to a tenth (a hundredth).
    """

    iterations: int = 3000  # one view of one timestep each; 4DGS: 3,000 and then 20,000
    resolution: int = 64  # cells along x, y, z at the coarser level
    levels: int = 2
    channels: int = 16
    width: int = 64  # of the two layers of the MLP
    # Adam, falls to a tenth; 4DGS: 1.6e-3 times the cameras' extent, 4.4 in NeRF-synthetic
    plane_rate: float = 7e-3
    mlp_rate: float = 7e-4  # 4DGS: 1.6e-4 times the same
    space_smoothness: float = 2e-4
    time_smoothness: float = 1e-3
    seed: int = 0


@dataclass(frozen=True)
class Tracker:
    """A `Trainer`: space stage as `modal`, then a deformation field."""

    config: TrackingConfig = TrackingConfig()

    def plain(self) -> dict[str, Any]:
        return {NAME: dataclasses.asdict(self.config)}

    def overrides(self) -> dict[str, str]:
        usual = dataclasses.asdict(TrackingConfig())
        own = dataclasses.asdict(self.config)
        return {f"{NAME}.{k}": str(v) for k, v in own.items() if v != usual[k]}

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
        track(run, capture, images, self.config, device)
        return run


def tracking(settings: Mapping[str, str], own: Mapping[str, str]) -> Trained:
    """The method; `settings` are those of `modal`, of which the space stage's count, `own` are `tracking.…`."""
    values = {k.partition(".")[2]: _number(k, v) for k, v in checked_settings(own).items()}
    ways = (Scoring(NAME, "modal"),)
    return Trained(Training(NAME, "modal", settings, ways, Tracker(TrackingConfig(**values))))


def checked_settings(given: Mapping[str, str]) -> dict[str, str]:
    """Settings `tracking.…`. Raises Tg4mmError for one that is none, and for a value that does not fit."""
    names = [f"{NAME}.{f.name}" for f in dataclasses.fields(TrackingConfig)]
    for name, text in given.items():
        if name not in names:
            raise Tg4mmError(f"--set {name}: tracking has {', '.join(names)}")
        _number(name, text)
    return dict(given)


def _number(name: str, text: str) -> Any:
    kind = type(getattr(TrackingConfig(), name.partition(".")[2]))
    try:
        value = kind(text)
    except ValueError:
        value = -1
    least = 0 if name.endswith(("smoothness", "seed")) else 1 if kind is int else 1e-12
    if not least <= value < 1e9:
        raise Tg4mmError(f"setting {name} is {text!r}, expected {kind.__name__} of at least {least:g}")
    return value


def track(
    run: Run, capture: Capture, images: ImageStack, config: TrackingConfig, device: str = "cpu"
) -> None:
    """Fit the field to all pictures and save it as the run's motion. A killed fit begins anew."""
    began = time.monotonic()
    reset_peak_memory()
    reset_gpu_peak(device)
    g = run.load_space().to(device)
    views = [cameras_on(views_at(capture, images, t), "cpu") for t in range(capture.n_timesteps)]
    with full_precision(device):
        field, shape = _fitted(g, views, config)
        n = capture.n_timesteps
        with torch.no_grad():
            series = np.stack([shape(field, t).cpu().numpy() for t in range(n)])
    freqs, phasors = series_modes(series, capture.fps)
    motion = ModalMotion(freqs, phasors[..., :3], phasors[..., 3:], capture.fps, n)
    n_parameters = sum(p.numel() for p in field.parameters())
    run.save_motion(
        motion,
        {
            "seconds": time.monotonic() - began,
            "peak_memory_mib": peak_memory_mib(),
            "iterations": config.iterations,
            "parameters": n_parameters,
            **gpu_figures(device),
        },
    )


def _fitted(g: Gaussians, views: list[Cameras], config: TrackingConfig) -> "tuple[HexPlane, Any]":
    """The field, and how its output [N, 6] (scene units, radians) at timestep t is got."""
    n = len(views)
    device = g.means.device
    box = torch.from_numpy(scene_box(g.means.cpu().numpy()).astype(np.float32)).to(device)
    points = ((g.means - box[0]) / (box[1] - box[0]) * 2 - 1).clamp(-1, 1)
    unit = float((box[1] - box[0]).max())
    field = HexPlane(config.resolution, config.levels, n, config.channels, config.width, config.seed).to(
        device
    )
    scale = torch.tensor([unit] * 3 + [1.0] * 3, device=device)

    def output(f: HexPlane, t: int) -> torch.Tensor:
        return f(points, 2 * t / max(n - 1, 1) - 1) * scale

    planes = {id(p) for p in field.planes}
    rest = [p for p in field.parameters() if id(p) not in planes]
    adam = torch.optim.Adam(
        [{"params": list(field.planes), "lr": config.plane_rate}, {"params": rest, "lr": config.mlp_rate}],
        eps=1e-15,
    )
    falls = torch.optim.lr_scheduler.ExponentialLR(adam, 0.1 ** (1 / config.iterations))
    draw = np.random.default_rng(config.seed)
    with progress("tracking", config.iterations) as update:
        for i in range(config.iterations):
            t = int(draw.integers(n))
            v = int(draw.integers(len(views[t][0])))
            out = output(field, t)
            moved = dataclasses.replace(g, means=g.means + out[:, :3], quats=rotated(g.quats, out[:, 3:]))
            space, steps = field.roughness()
            viewmats, intrinsics, pictures = (x[v : v + 1].to(device) for x in views[t])
            loss = view_loss(moved, (viewmats, intrinsics, pictures), 0)
            (loss + config.space_smoothness * space + config.time_smoothness * steps).backward()
            adam.step()
            falls.step()
            adam.zero_grad(set_to_none=True)
            update(i + 1)
    return field, output


_PAIRS = tuple(combinations(range(4), 2))  # of x, y, z, t


class HexPlane(nn.Module):
    """(points in −1..1, time in −1..1) → displacement [N, 3] and rotation vectors [N, 3], in the units of `scale`."""

    def __init__(
        self, resolution: int, levels: int, n_timesteps: int, channels: int, width: int, seed: int
    ) -> None:
        super().__init__()
        draw = torch.Generator().manual_seed(seed)
        self.planes = nn.ParameterList()
        for level in range(levels):
            size = (resolution << level,) * 3 + (n_timesteps,)
            for a, b in _PAIRS:
                shape = (1, channels, size[b], size[a])
                # As published: over space random in 0.1 … 0.5, over time 1, so that time changes nothing yet.
                first = torch.ones(shape) if b == 3 else 0.1 + 0.4 * torch.rand(shape, generator=draw)
                self.planes.append(nn.Parameter(first))
        self.layers = nn.ModuleList(
            _linear(a, b, draw) for a, b in pairwise((channels * levels, width, width))
        )
        self.head = nn.Linear(width, 6)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)

    def forward(self, points: Tensor, time: float) -> Tensor:
        """[N, 6] at points [N, 3]; columns displacement and rotation."""
        at = [*points.unbind(1), torch.full_like(points[:, 0], time)]
        features = []
        for first in range(0, len(self.planes), len(_PAIRS)):
            product: Tensor | None = None
            for plane, (a, b) in zip(self.planes[first : first + len(_PAIRS)], _PAIRS, strict=True):
                where = torch.stack([at[a], at[b]], -1)[None, None]
                values = grid_sample(plane, where, align_corners=True, padding_mode="border")[0, :, 0].T
                product = values if product is None else product * values
            features.append(product)
        x = torch.cat([f for f in features if f is not None], 1)
        for layer in self.layers:
            x = torch.relu(layer(x))
        return self.head(x)

    def roughness(self) -> tuple[Tensor, Tensor]:
        """(total variation of the planes over space, second difference of the others over time), means of squares."""
        space, time = self.planes[0].new_zeros(()), self.planes[0].new_zeros(())
        for i, plane in enumerate(self.planes):
            if _PAIRS[i % len(_PAIRS)][1] == 3:
                time = time + plane.diff(n=2, dim=2).square().mean() if plane.shape[2] > 2 else time
            else:
                space = space + plane.diff(dim=2).square().mean() + plane.diff(dim=3).square().mean()
        return space, time


def _linear(n_in: int, n_out: int, draw: torch.Generator) -> nn.Linear:
    layer = nn.Linear(n_in, n_out)
    bound = (6 / (n_in + n_out)) ** 0.5  # Glorot's uniform
    with torch.no_grad():
        layer.weight.copy_((2 * torch.rand(n_out, n_in, generator=draw) - 1) * bound)
        layer.bias.zero_()
    return layer
