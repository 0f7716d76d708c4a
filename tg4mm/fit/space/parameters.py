"""The free parameters of static Gaussians and their Adam optimiser, which survives adding and removing rows."""

import math
from abc import ABC, abstractmethod

import numpy as np
import torch
from torch import Tensor

from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.space.initial import InitialPoints

SH_C0 = 0.28209479177387814
# Learning rates of the first iteration; that of the means is per unit of `stride`.
LEARNING_RATES = {
    "means": 1.6e-3,
    "quats": 2e-3,
    "log_scales": 2e-2,
    "logits": 4.5e-2,
    "sh0": 7.5e-3,
    "shn": 7.5e-4,
}
_FULL_STRIDE = 128  # pixels: up to this size means are that fast, in larger pictures as many pixels a step
_MEANS_DECAY = 0.01  # factor at the end, exponential all along
_DECAY = 0.1  # of the others, exponential over the second half


def initial_parameters(
    points: InitialPoints, sh_degree: int, generator: torch.Generator
) -> dict[str, Tensor]:
    """One isotropic Gaussian of opacity 0.3 on each point, as wide as the points are apart."""
    n = len(points.xyz)
    sh0 = (torch.from_numpy(points.rgb) - 0.5) / SH_C0
    quats = torch.nn.functional.normalize(torch.randn(n, 4, generator=generator), dim=1)
    return {
        "means": torch.from_numpy(points.xyz),
        "quats": quats,
        "log_scales": torch.from_numpy(np.log(points.spacing))[:, None].repeat(1, 3),
        "logits": torch.full((n,), math.log(0.3 / 0.7)),
        "sh0": sh0[:, None],
        "shn": torch.zeros(n, (sh_degree + 1) ** 2 - 1, 3),
    }


def activate(parameters: dict[str, Tensor]) -> Gaussians:
    """The Gaussians that the free parameters stand for; gradients flow."""
    p = parameters
    return Gaussians(
        p["means"],
        p["quats"],
        p["log_scales"].exp(),
        p["logits"].sigmoid(),
        torch.cat([p["sh0"], p["shn"]], 1),
    )


def stride(extent: float, width: int, height: int) -> float:
    """Return the length (scene units) that scales the means' learning rate: the extent, limited by pixel size."""
    return extent * min(1.0, _FULL_STRIDE / max(width, height))


def learning_rates(stride: float, progress: float, pace: float = 1.0) -> dict[str, float]:
    """The rates at `progress` in 0..1 of the whole fit, in the order of `LEARNING_RATES`."""
    decay = _DECAY ** max(0.0, 2 * progress - 1)
    rates = {name: rate * decay for name, rate in LEARNING_RATES.items()}
    return rates | {"means": LEARNING_RATES["means"] * pace * stride * _MEANS_DECAY**progress}


class ParameterRows(ABC):
    """Named parameters [N, …] with an optimiser's moments; rows come and go."""

    parameters: dict[str, Tensor]

    def __init__(
        self, parameters: dict[str, Tensor], stride: float, moments: dict[str, Tensor] | None = None
    ) -> None:
        """`moments` continues an earlier optimiser: what `moments()` returned. What is given is copied."""
        self._stride = stride
        self._build(parameters, moments)

    @abstractmethod
    def _build(self, parameters: dict[str, Tensor], moments: dict[str, Tensor] | None) -> None:
        """Start from these values."""

    @abstractmethod
    def moments(self) -> dict[str, Tensor]:
        """Adam's state by name: `<name>.m`, `<name>.v`, and `step`. Empty before the first step."""

    def replace(self, gone: Tensor, added: dict[str, Tensor]) -> None:
        """Put `added`, with zero moments, into the rows `gone` (indices), and the remaining ones at the end.

        Where fewer are added, the rows that stay close up.
        """
        n, count = len(self.parameters["logits"]), len(added["logits"])
        rows = torch.arange(n + count, device=gone.device)  # those there, then `added`
        taken = min(len(gone), count)
        rows[gone[:taken]] = rows[n : n + taken].clone()
        stays = torch.ones_like(rows, dtype=torch.bool)
        stays[n : n + taken] = False
        stays[gone[taken:]] = False
        self._select(rows[stays], added)

    def reorder(self, order: Tensor) -> None:
        """Sort the rows: row i becomes the former row order[i]."""
        self._select(order, {name: p[:0].detach() for name, p in self.parameters.items()})

    def _select(self, rows: Tensor, added: dict[str, Tensor]) -> None:
        """Keep these rows of those there and, numbered on from them, `added`."""
        moments = self.moments()
        parameters = {}
        for name, p in self.parameters.items():
            parameters[name] = torch.cat([p.detach(), added[name]])[rows]
            for kind in (".m", ".v") if moments else ():
                moments[name + kind] = torch.cat([moments[name + kind], torch.zeros_like(added[name])])[rows]
        self._build(parameters, moments or None)


class ParameterAdam(ParameterRows):
    """torch's fused Adam; gradients are those that autograd leaves on `parameters`."""

    def _build(self, parameters: dict[str, Tensor], moments: dict[str, Tensor] | None) -> None:
        self.parameters = {k: v.detach().clone().requires_grad_() for k, v in parameters.items()}
        groups = [{"params": [p], "name": k, "lr": LEARNING_RATES[k]} for k, p in self.parameters.items()]
        self._adam = torch.optim.Adam(groups, eps=1e-15, fused=True)
        if moments is not None:
            for name, p in self.parameters.items():
                self._adam.state[p] = {
                    "step": moments["step"].clone(),
                    "exp_avg": moments[f"{name}.m"],
                    "exp_avg_sq": moments[f"{name}.v"],
                }

    def step(self, progress: float, pace: float = 1.0) -> None:
        """One step with the learning rates at `progress` in 0..1 of the whole fit; gradients are cleared."""
        rates = learning_rates(self._stride, progress, pace)
        for group in self._adam.param_groups:
            group["lr"] = rates[group["name"]]
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)

    def moments(self) -> dict[str, Tensor]:
        state = {name: self._adam.state[p] for name, p in self.parameters.items()}
        if not state["means"]:
            return {}
        out = {"step": state["means"]["step"]}
        for name, s in state.items():
            out |= {f"{name}.m": s["exp_avg"], f"{name}.v": s["exp_avg_sq"]}
        return out
