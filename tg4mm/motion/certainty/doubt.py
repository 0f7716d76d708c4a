"""What a run says of its motion's uncertainty where cameras are too few to be halved, and what of it is a guess."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tg4mm.gaussians import Gaussians
from tg4mm.motion.certainty.posterior import Posterior, n_solves, posterior
from tg4mm.motion.certainty.sight import lines_of_sight, sight_ratio
from tg4mm.motion.jacobian.view import ViewJacobian
from tg4mm.motion.pictures.video import FixedCamera
from tg4mm.motion.solver.problem import MotionProblem
from tg4mm.progress import progress


@dataclass(frozen=True)
class Doubt:
    """Tensors of `uncertainty.safetensors`, and figures for the log."""

    tensors: Mapping[str, Tensor]
    figures: Mapping[str, Any]


def doubt(
    problem: MotionProblem,
    pictures: np.ndarray,
    shapes: np.ndarray,
    gaussians: Gaussians,
    cameras: list[FixedCamera],
    n_timesteps: int,
    seed: int,
) -> Doubt:
    """How uncertain the shapes [R, N, DOF] are that were fitted to component images [V, R, H, W, 3].

    One camera alone is warned of, with the part of the motion along its line of sight that is a guess.
    """
    with progress("uncertainty", n_solves(len(shapes)), "fits") as update:
        found = posterior(problem, pictures, n_timesteps, seed, update)
    tensors = {
        "displacement": torch.from_numpy(found.deviation),
        "covariance": torch.from_numpy(found.covariance),
    }
    power = max(float((shapes[..., :3].astype(np.float64) ** 2).sum()) / n_timesteps, 1e-30)
    ratio = float(np.sqrt((found.deviation.astype(np.float64) ** 2).sum() / power))
    figures: dict[str, Any] = {"noise_to_motion": ratio, "freedom": found.freedom}
    if len(cameras) == 1:
        view, camera = problem.views[0], cameras[0]
        along, guess = _along_sight(found, view, camera, gaussians, shapes, n_timesteps)
        tensors |= {k: torch.from_numpy(v) for k, v in along.items()}
        percent = figures["guess_along_sight_percent"] = round(100 * guess, 1)
        _warn_of_depth(sight_ratio(view, camera, gaussians.means.numpy(), seed), percent)
    return Doubt(tensors, figures)


def _along_sight(
    found: Posterior,
    view: ViewJacobian,
    camera: FixedCamera,
    gaussians: Gaussians,
    shapes: np.ndarray,
    n_timesteps: int,
) -> tuple[dict[str, np.ndarray], float]:
    """Deviations [N] along the line of sight and across it, and what part of the motion along it is a guess.

    That is the variance of what is not known over that of the motion: what was found, squared, and what is not known.
    Gaussians that are seen count by their opacity.
    """
    along = lines_of_sight(camera, gaussians.means.numpy())
    variance = np.einsum("nc,ncd,nd->n", along, found.covariance, along)
    across = np.maximum(np.trace(found.covariance, axis1=1, axis2=2) - variance, 0) / 2
    shown = (np.einsum("rnc,nc->rn", shapes[..., :3], along) ** 2).sum(0) / n_timesteps
    weights = np.zeros(len(gaussians))
    rows = view.bins.order[: view.bins.n_visible]
    weights[rows] = gaussians.opacities.numpy()[rows]
    unknown = float((weights * variance).sum())
    guess = unknown / max(unknown + float((weights * shown).sum()), 1e-30)
    deviations = {"along_sight": variance, "across_sight": across}
    return {k: np.sqrt(np.maximum(v, 0)).astype(np.float32) for k, v in deviations.items()}, guess


def _warn_of_depth(ratio: float, percent: float) -> None:
    warnings.warn(
        f"one camera: motion along its line of sight changes the pictures {ratio:.2g} times as much as motion across, "
        f"so that {percent:.0f} % of the variance of the motion along it is a guess from neighbours; "
        "a second camera from the side would show it",
        stacklevel=4,
    )
