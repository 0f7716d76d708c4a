"""Parameters under Adam with everything a checkpoint needs to go on bit for bit: both phases of `paper` use it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.space.view import render_view

# Gradients of single cells are far below Adam's usual 1e-8, which would slow them down; as in 3D Gaussian Splatting.
_EPS = 1e-15

Cameras = tuple[Tensor, Tensor, Tensor]  # viewmats [V, 4, 4], Ks [V, 3, 3], pictures [V, H, W, 3]


class Fit:
    """Named parameters, torch's fused Adam, and a random order of views.

    The rate falls exponentially to `final` times what it is at the start; 1: it is fixed.
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
        """Every view once, in random order, then again."""
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
        """Go on from what `tensors` and `state` gave."""
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
    """[TG4MM] Eq. (16) of view v over white: the mean over pixels of |rendered − picture|."""
    viewmats, Ks, pictures = cameras
    height, width = pictures.shape[1:3]
    view = render_view(gaussians, viewmats[v], Ks[v], (width, height), gaussians.sh_degree)
    return (view.rgb - pictures[v]).abs().mean()
