"""The deformation field of 4DGS (Wu et al. 2024): six planes over pairs of x, y, z, t, and an MLP.

Features of a plane are sampled bilinearly; those of the six planes are multiplied, those of several resolutions
concatenated. Two linear heads give displacement and rotation vector; they start at zero, so nothing moves at first.
"""

from __future__ import annotations

from itertools import combinations, pairwise

import torch
from torch import Tensor, nn
from torch.nn.functional import grid_sample

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
