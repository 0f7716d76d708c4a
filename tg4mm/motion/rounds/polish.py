"""The scene at rest once its motion is known: sharp where the mean over time is blurred.

The space stage sees the mean over time of what each camera saw. Motion of a pixel or more blurs it, and so the
Gaussians. With the motion found, every state's own picture can be compared with the Gaussians moved there. Their
number and order stay, so that the motion stays theirs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tg4mm.gaussians import Gaussians
from tg4mm.motion.animate import rotated
from tg4mm.motion.pictures.video import FixedCamera
from tg4mm.space.losses import photometric_loss
from tg4mm.space.parameters import ParameterAdam, activate, stride
from tg4mm.space.view import render_view

_L2 = 10.0  # weight of the squared error, as in the space stage
_BEGIN = 0.5  # of the space stage's course: its learning rates go on from there
_SOLID = 1e-6  # opacities are this far from 0 and 1, which no logit reaches
_WITHIN = 0.99  # part of the Gaussians that counts for the scene's extent


@dataclass(frozen=True)
class Seen:
    """What there is to compare with: K states of T timesteps in V cameras."""

    cameras: list[FixedCamera]
    pictures: np.ndarray  # [V, K, H, W, 3] float32 over white
    # [K, N, 6] float32: displacement (scene units) and rotation vector (radians) at each state
    motions: np.ndarray
    of: np.ndarray  # [T] the state of each timestep


@dataclass
class Polish:
    """Where it stands: parameters and moments, which pictures are left in this pass, how many iterations are done."""

    adam: ParameterAdam
    generator: torch.Generator
    iterations: int
    stride: float  # scene units, of the learning rate of the means
    done: int = 0
    order: list[int] = field(default_factory=list)

    @staticmethod
    def begun(gaussians: Gaussians, iterations: int, size: tuple[int, int], seed: int, device: str) -> Polish:
        """`size`: width and height of the pictures."""
        parameters = {k: v.to(device) for k, v in _parameters(gaussians).items()}
        away = torch.linalg.vector_norm(gaussians.means - gaussians.means.mean(0), dim=1)
        step = stride(float(torch.quantile(away, _WITHIN)), *size)
        return Polish(ParameterAdam(parameters, step), torch.Generator().manual_seed(seed), iterations, step)

    def step(self, seen: Seen) -> None:
        """Compare one camera's picture of the state of one timestep, and change the Gaussians.

        A pass takes every timestep of every camera once, so that states count by how long they last.
        """
        height, width = seen.pictures.shape[2:4]
        if not self.order:
            self.order = torch.randperm(len(seen.cameras) * len(seen.of), generator=self.generator).tolist()
        v, t = divmod(self.order.pop(), len(seen.of))
        k = int(seen.of[t])
        device = self.adam.parameters["means"].device
        camera = seen.cameras[v]
        viewmat, K, target, motion = (
            torch.from_numpy(a).to(device)
            for a in (camera.viewmat, camera.K, seen.pictures[v, k], seen.motions[k])
        )
        there = at_state(activate(self.adam.parameters), motion)
        view = render_view(there, viewmat, K, (width, height), there.sh_degree)
        photometric_loss(view.rgb, target, _L2, 0.0).backward()
        self.adam.step(_BEGIN + (1 - _BEGIN) * self.done / self.iterations)
        self.done += 1

    def gaussians(self) -> Gaussians:
        """As they are now, on the CPU."""
        return activate(self.adam.parameters).detach().to("cpu")

    def tensors(self) -> dict[str, Tensor]:
        adam = self.adam.parameters | {f"adam.{k}": v for k, v in self.adam.moments().items()}
        return {k: v.detach().cpu().contiguous() for k, v in adam.items()} | {
            "generator": self.generator.get_state()
        }

    def state(self) -> dict[str, Any]:
        return {"iterations": self.iterations, "done": self.done, "order": self.order}

    @staticmethod
    def restored(
        tensors: Mapping[str, Tensor],
        state: Mapping[str, Any],
        start: Gaussians,
        size: tuple[int, int],
        device: str,
    ) -> Polish:
        """From what `tensors` and `state` gave; `start`: the Gaussians it was begun with."""
        polish = Polish.begun(start, state["iterations"], size, 0, device)
        polish.generator.set_state(tensors["generator"])
        there = {k: v.to(device) for k, v in tensors.items() if k != "generator"}
        moments = {k.removeprefix("adam."): v for k, v in there.items() if k.startswith("adam.")}
        parameters = {k: v for k, v in there.items() if not k.startswith("adam.")}
        polish.adam = ParameterAdam(parameters, polish.stride, moments or None)
        polish.done, polish.order = state["done"], list(state["order"])
        return polish


def at_state(gaussians: Gaussians, motion: Tensor) -> Gaussians:
    """The Gaussians displaced and turned by `motion` [N, 6]: scene units, and rotation vectors in radians."""
    means, quats = gaussians.means + motion[:, :3], rotated(gaussians.quats, motion[:, 3:])
    return replace(gaussians, means=means, quats=quats)


def _parameters(gaussians: Gaussians) -> dict[str, Tensor]:
    """What `activate` makes these Gaussians of."""
    opacities = gaussians.opacities.clamp(_SOLID, 1 - _SOLID)
    return {
        "means": gaussians.means,
        "quats": gaussians.quats,
        "log_scales": gaussians.scales.clamp_min(1e-12).log(),
        "logits": torch.log(opacities) - torch.log1p(-opacities),
        "sh0": gaussians.sh[:, :1],
        "shn": gaussians.sh[:, 1:],
    }
