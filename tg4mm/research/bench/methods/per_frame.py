"""3DGS for each timestep by itself: the Gaussians at rest, fine-tuned to its pictures; the difference is motion."""

from dataclasses import dataclass

import torch

from tg4mm.core.progress import progress
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.animate import moved
from tg4mm.research.bench.methods.deformed import Moving, box_of
from tg4mm.research.paper.space import Cameras, Fit, view_loss

NAME = "per-frame"


@dataclass(frozen=True)
class PerFrameConfig:
    """Positions and rotations are tuned; the rate falls to `falls_to` within a timestep, so that they come to rest."""

    iterations: int = 100  # of each timestep, one view each
    rate: float = 2e-4  # of Adam; of displacements per unit of the scene's box
    falls_to: float = 0.03
    seed: int = 0


def tune(g: Gaussians, views: list[Cameras], config: PerFrameConfig) -> Moving:
    """[T, N, 6] each timestep's own, from zero."""
    box, n = box_of(g), config.iterations
    unit = torch.tensor([float((box[1] - box[0]).max())] * 3 + [1.0] * 3, device=g.means.device)
    series = []
    with progress(NAME, len(views) * n) as update:
        for t, (viewmats, ks, pictures) in enumerate(views):
            cameras = viewmats.to(unit.device), ks.to(unit.device), pictures.to(unit.device)
            zero = {"motion": torch.zeros(len(g), 6)}
            fit = Fit(zero, config.rate, n, config.seed + t, str(unit.device), config.falls_to)
            while fit.iteration < n:
                posed = moved(g, fit.parameters["motion"] * unit)
                fit.step(view_loss(posed, cameras, fit.next_view(len(pictures))))
                update(t * n + fit.iteration)
            series.append((fit.parameters["motion"] * unit).detach())
    return Moving(g, torch.stack(series), len(views) * n, 6 * len(g))
