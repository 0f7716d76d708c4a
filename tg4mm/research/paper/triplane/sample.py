"""Sampling a triplane's active cells at its points: [TG4MM] Eqs. (4) and (5), with the gradient."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tg4mm.research.paper.triplane.cells import Cells
from tg4mm.research.paper.triplane.kernels import gather, gather_back


class _Sample(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: Tensor, cells: Cells) -> Tensor:
        out = torch.empty(cells.index.shape[1], 3 * values.shape[1])
        gather(values.detach().contiguous().numpy(), cells.index, cells.weight, out.numpy())
        ctx.cells, ctx.channels = cells, values.shape[1]
        return out

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        c = ctx.cells
        v_values = torch.empty(len(c), ctx.channels)
        v_out = grads[0].contiguous().numpy()
        gather_back(v_out, c.first, c.point, c.plane, c.share, v_values.numpy())
        return v_values, None


def sample(values: Tensor, cells: Cells) -> Tensor:
    """Embedding [N, 3 C] of the points from values [A, C] float32 of the active cells; concatenated xy, xz, yz.

    CPU tensors go to numba kernels, others through torch (whose sums of gradients run by atomics on CUDA).
    Raises ValueError for values of another shape.
    """
    if values.ndim != 2 or len(values) != len(cells):
        raise ValueError(f"values have shape {tuple(values.shape)}, expected ({len(cells)}, channels)")
    if values.device.type == "cpu" and values.dtype == torch.float32:
        return _Sample.apply(values, cells)
    return sample_torch(values, cells)


def sample_torch(values: Tensor, cells: Cells) -> Tensor:
    """The same by torch's own operations, on any device and in any precision."""
    index, weight = _on(cells, values.device)
    parts = (values[index] * weight.to(values.dtype)[..., None]).sum(2)  # [3, N, C]
    return torch.cat(list(parts), 1)


@lru_cache(maxsize=2)
def _on(cells: Cells, device: torch.device) -> tuple[Tensor, Tensor]:
    """Index and weight, brought to a device once."""
    return torch.from_numpy(cells.index.astype(np.int64)).to(device), torch.from_numpy(cells.weight).to(
        device
    )
