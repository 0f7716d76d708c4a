"""Gaussians moved by a `HexPlane`, in the manner of 4DGS, the dynamic 3DGS in [TG4MM] Table V.

`tracking`: the Gaussians at rest are those of `modal`. `4dgs`: they are trained together with the field, and move from
timestep 0 on. Departures from the published 4DGS: no densification after the start, size and opacity do
not change over time, and the time planes have a cell for each timestep.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations, pairwise

import torch
from torch import Tensor, nn
from torch.nn.functional import grid_sample

from tg4mm.fit.gaussians import Gaussians
from tg4mm.research.bench.methods.deformed import Free, Moving, box_of, descend, from_first
from tg4mm.research.paper.space import Cameras

NAME, ALONG = "tracking", "4dgs"
_PAIRS = tuple(combinations(range(4), 2))  # of x, y, z, t


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


def track(g: Gaussians, views: list[Cameras], config: TrackingConfig) -> Moving:
    """Fit the field that moves the fixed Gaussians."""
    field, motion = _fitted(g, lambda: g, [], views, config)
    with torch.no_grad():
        series = torch.stack([motion(t) for t in range(len(views))])
    return Moving(g, series, config.iterations, sum(p.numel() for p in field.parameters()))


def track_along(g: Gaussians, views: list[Cameras], config: TrackingConfig) -> Moving:
    """Fit the field and the Gaussians together."""
    free = Free(g)
    field, motion = _fitted(g, free.now, free.groups, views, config)
    trained = [*field.parameters(), *free.parameters.values()]
    return Moving(
        *from_first(free.now(), motion, len(views)), config.iterations, sum(p.numel() for p in trained)
    )


def _fitted(
    g: Gaussians, now: Callable[[], Gaussians], groups: list, views: list[Cameras], config: TrackingConfig
) -> "tuple[HexPlane, Callable[[int], Tensor]]":
    """Fit and return the field, and a function of the timestep for the motion [N, 6] of `g` (scene units, radians)."""
    n, device, box = len(views), g.means.device, box_of(g)
    points = ((g.means - box[0]) / (box[1] - box[0]) * 2 - 1).clamp(-1, 1)
    unit = float((box[1] - box[0]).max())
    field = HexPlane(config.resolution, config.levels, n, config.channels, config.width, config.seed).to(
        device
    )
    scale = torch.tensor([unit] * 3 + [1.0] * 3, device=device)

    def motion(t: int) -> Tensor:
        return field(points, 2 * t / max(n - 1, 1) - 1) * scale

    def rough(t: int) -> Tensor:
        space, steps = field.roughness()
        return config.space_smoothness * space + config.time_smoothness * steps

    planes = {id(p) for p in field.planes}
    rest = [p for p in field.parameters() if id(p) not in planes]
    own = [{"params": list(field.planes), "lr": config.plane_rate}, {"params": rest, "lr": config.mlp_rate}]
    name = ALONG if groups else NAME
    descend(name, now, motion, rough, [*own, *groups], views, config.iterations, config.seed)
    return field, motion


class HexPlane(nn.Module):
    """Map points and time in −1..1 to displacements [N, 3] and rotation vectors [N, 3], in the units of `scale`."""

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
            linear_layer(a, b, draw) for a, b in pairwise((channels * levels, width, width))
        )
        self.head = nn.Linear(width, 6)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)

    def forward(self, points: Tensor, time: float) -> Tensor:
        """Return displacement and rotation [N, 6] at points [N, 3]."""
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
        """Return mean squares of the spatial planes' total variation, and of the others' second difference in time."""
        space, time = self.planes[0].new_zeros(()), self.planes[0].new_zeros(())
        for i, plane in enumerate(self.planes):
            if _PAIRS[i % len(_PAIRS)][1] == 3:
                time = time + plane.diff(n=2, dim=2).square().mean() if plane.shape[2] > 2 else time
            else:
                space = space + plane.diff(dim=2).square().mean() + plane.diff(dim=3).square().mean()
        return space, time


def linear_layer(n_in: int, n_out: int, draw: torch.Generator) -> nn.Linear:
    """Return a layer with random weights and no bias."""
    layer = nn.Linear(n_in, n_out)
    bound = (6 / (n_in + n_out)) ** 0.5  # Glorot's uniform
    with torch.no_grad():
        layer.weight.copy_((2 * torch.rand(n_out, n_in, generator=draw) - 1) * bound)
        layer.bias.zero_()
    return layer
