"""The scene at rest once its motion is known: sharp where the mean over time is blurred."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from tg4mm.core.memory import release
from tg4mm.core.progress import progress
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.animate import moved
from tg4mm.fit.motion.jacobian.view import PosedView
from tg4mm.fit.space.losses import photometric_loss
from tg4mm.fit.space.parameters import ParameterAdam, activate, stride
from tg4mm.fit.space.view import render_view

_L2 = 10.0  # weight of the squared error, as in the space stage
_BEGIN = 0.5  # of the space stage's course: its learning rates go on from there
_SOLID = 1e-6  # opacities are this far from 0 and 1, which no logit reaches
_WITHIN = 0.99  # part of the Gaussians that counts for the scene's extent


@dataclass(frozen=True)
class MovedPictures:
    """Pictures of K states of T timesteps in V cameras."""

    cameras: Sequence[PosedView]
    pictures: np.ndarray  # [V, K, H, W, 3] float32 over white, `room`
    motions: np.ndarray  # [K, N, 6] float32: displacement and rotation vector at each state
    of: np.ndarray  # [T] the state of each timestep


def refine_rest_scene(
    gaussians: Gaussians,
    seen: MovedPictures,
    iterations: int,
    seed: int,
    device: str,
    update: Callable[[int], None] | None = None,
) -> Gaussians:
    """The Gaussians at rest that show all states' pictures best, by Adam on one camera and timestep at a time.

    A pass takes every timestep of every camera once, so that states count by how long they last.
    """
    height, width = seen.pictures.shape[2:4]
    parameters = {k: v.to(device) for k, v in _parameters(gaussians).items()}
    away = torch.linalg.vector_norm(gaussians.means - gaussians.means.mean(0), dim=1)
    adam = ParameterAdam(parameters, stride(float(torch.quantile(away, _WITHIN)), width, height))
    generator = torch.Generator().manual_seed(seed)
    order: list[int] = []
    for done in range(iterations):
        order = order or torch.randperm(len(seen.cameras) * len(seen.of), generator=generator).tolist()
        v, t = divmod(order.pop(), len(seen.of))
        _compare(adam, seen, v, int(seen.of[t]), device)
        adam.step(_BEGIN + (1 - _BEGIN) * done / iterations)
        if update is not None:
            update(done + 1)
    return activate(adam.parameters).detach().to("cpu")


def refine_at_rest(
    gaussians: Gaussians,
    cameras: Sequence[PosedView],
    pictures: np.ndarray,
    iterations: int,
    seed: int,
    device: str,
) -> Gaussians:
    """The Gaussians that show `pictures` [V, H, W, 3] over white of V cameras best, in which nothing moves."""
    still = np.zeros((1, len(gaussians), 6), np.float32)
    seen = MovedPictures(cameras, pictures[:, None], still, np.zeros(1, np.int64))
    with progress("scene at rest, refined", iterations, "iterations") as update:
        return refine_rest_scene(gaussians, seen, iterations, seed, device, update)


def _compare(adam: ParameterAdam, seen: MovedPictures, v: int, k: int, device: str) -> None:
    camera, (height, width) = seen.cameras[v], seen.pictures.shape[2:4]
    viewmat, K, target, motion = (
        torch.from_numpy(a).to(device)
        for a in (camera.viewmat, camera.K, seen.pictures[v, k], seen.motions[k])
    )
    there = moved(activate(adam.parameters), motion)
    view = render_view(there, viewmat, K, (width, height), there.sh_degree, camera.low_pass)
    photometric_loss(view.rgb, target, _L2, 0.0).backward()
    release(seen.pictures)


def _parameters(gaussians: Gaussians) -> dict[str, Tensor]:
    """Return the parameters of these Gaussians, the inverse of `activate`."""
    opacities = gaussians.opacities.clamp(_SOLID, 1 - _SOLID)
    return {
        "means": gaussians.means,
        "quats": gaussians.quats,
        "log_scales": gaussians.scales.clamp_min(1e-12).log(),
        "logits": torch.log(opacities) - torch.log1p(-opacities),
        "sh0": gaussians.sh[:, :1],
        "shn": gaussians.sh[:, 1:],
    }
