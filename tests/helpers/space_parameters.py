"""One step of Adam on random gradients."""

import torch
from torch import Tensor

from tg4mm.fit.space.parameters import ParameterAdam

N, EXTENT = 6, 1.7


def gradients(like: dict[str, Tensor], seed: int) -> dict[str, Tensor]:
    g = torch.Generator().manual_seed(seed)
    return {k: torch.randn(v.shape, generator=g) for k, v in like.items()}


def take_step(adam: ParameterAdam, grads: dict[str, Tensor], progress: float = 0.0) -> None:
    for name, p in adam.parameters.items():
        p.grad = grads[name].clone()
    adam.step(progress)
