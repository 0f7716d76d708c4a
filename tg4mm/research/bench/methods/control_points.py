"""Sparse control points that carry the Gaussians, in the manner of SC-GS, which [TG4MM] Table V compares with.

An MLP of a point's place and the time gives each control point a displacement and a rotation; Gaussians follow their
nearest four (linear blend skinning, weights by learned radii), and control points are held as rigid as possible. The
Gaussians are trained along, and timestep 0 is what they move from. Departures from the published SC-GS: rotations in
ARAP are the MLP's own (there fitted to the points), no densification of Gaussians or points, no learned features, a
smaller MLP.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn

from tg4mm.fit.gaussians import Gaussians
from tg4mm.research.bench.methods.deformed import Free, Moving, box_of, descend, from_first
from tg4mm.research.bench.methods.tracking import linear_layer
from tg4mm.research.paper.space import Cameras

NAME = "sc-gs"
_CARRY = 4  # control points of a Gaussian
_STIFF = 8  # neighbours of a control point in ARAP
_OCTAVES = (4, 6)  # of the encoding of places and of time


@dataclass(frozen=True)
class ControlConfig:
    """Settings after SC-GS's."""

    iterations: int = 3000  # one view of one timestep each; SC-GS: 80,000
    points: int = 512
    layers: int = 4  # 8 there
    width: int = 128  # 256 there
    rate: float = 7e-4  # of Adam, of the MLP and the radii; falls to a tenth
    stiffness: float = 1e-2  # weight of ARAP, of changes of distance per distance
    seed: int = 0


def carry(g: Gaussians, views: list[Cameras], config: ControlConfig) -> Moving:
    """Fit control points and Gaussians together."""
    free, n = Free(g), len(views)
    points = ControlPoints(g, config).to(g.means.device)

    def motion(t: int) -> Tensor:
        return points(free.parameters["means"], t / n)

    def stiff(t: int) -> Tensor:
        return config.stiffness * points.stretch(t / n)

    groups = [{"params": list(points.parameters()), "lr": config.rate}, *free.groups]
    descend(NAME, free.now, motion, stiff, groups, views, config.iterations, config.seed)
    trained = [*points.parameters(), *free.parameters.values()]
    return Moving(*from_first(free.now(), motion, n), config.iterations, sum(p.numel() for p in trained))


class ControlPoints(nn.Module):
    """(means [N, 3], time in 0..1) → displacements and rotation vectors [N, 6], scene units and radians."""

    at: Tensor  # [K, 3] scene units
    carriers: Tensor  # [N, 4] the control points of every Gaussian
    neighbours: Tensor  # [K, 8] of every control point

    def __init__(self, g: Gaussians, config: ControlConfig) -> None:
        from scipy.spatial import cKDTree

        super().__init__()
        means, box = g.means.detach().cpu(), box_of(g).cpu()
        at = means[spread(means, config.points)]
        tree = cKDTree(at.numpy())
        apart, near = tree.query(at.numpy(), k=min(_STIFF + 1, len(at)))
        self.unit = float((box[1] - box[0]).max())
        self.register_buffer("at", at)
        self.register_buffer("neighbours", torch.from_numpy(near[:, 1:]))
        self.register_buffer(
            "carriers", torch.from_numpy(tree.query(means.numpy(), k=min(_CARRY, len(at)))[1])
        )
        self.radii = nn.Parameter(torch.from_numpy(np.log(np.maximum(apart[:, 1], 1e-6)).astype(np.float32)))
        n_in = 3 * (1 + 2 * _OCTAVES[0]) + 1 + 2 * _OCTAVES[1]
        draw = torch.Generator().manual_seed(config.seed)
        sizes = [n_in, *[config.width] * config.layers, 6]
        self.layers = nn.ModuleList(linear_layer(a, b, draw) for a, b in pairwise(sizes))
        nn.init.zeros_(self.layers[-1].get_parameter("weight"))

    def moves(self, time: float) -> Tensor:
        """Return the motion of the control points [K, 6]."""
        when = torch.full_like(self.at[:, :1], time)
        x = torch.cat([_encoded(self.at / self.unit, _OCTAVES[0]), _encoded(when, _OCTAVES[1])], 1)
        for layer in self.layers[:-1]:
            x = torch.relu(layer(x))
        out = self.layers[-1](x)
        return torch.cat([out[:, :3] * self.unit, out[:, 3:]], 1)

    def forward(self, means: Tensor, time: float) -> Tensor:
        moves = self.moves(time)[self.carriers]  # [N, 4, 6]
        away = means[:, None] - self.at[self.carriers]
        near = -away.square().sum(-1) / (2 * (2 * self.radii[self.carriers]).exp())
        weights = torch.softmax(near, 1)[..., None]
        shift = _turned(away, moves[..., 3:]) - away + moves[..., :3]
        return (weights * torch.cat([shift, moves[..., 3:]], -1)).sum(1)

    def stretch(self, time: float) -> Tensor:
        """Return ARAP: the mean square of the neighbours' departure from a rotation, by their distance at rest."""
        moves = self.moves(time)
        apart = self.at[self.neighbours] - self.at[:, None]
        now = apart + moves[self.neighbours, :3] - moves[:, None, :3]
        wanted = _turned(apart, moves[:, None, 3:].expand_as(apart))
        length = apart.square().sum(-1).clamp_min(1e-12)
        return ((now - wanted).square().sum(-1) / length).mean()


def _turned(vectors: Tensor, rotation: Tensor) -> Tensor:
    """Turn vectors [..., 3] by rotation vectors [..., 3], to second order in the angle."""
    first = torch.linalg.cross(rotation, vectors)
    return vectors + first + torch.linalg.cross(rotation, first) / 2


def _encoded(x: Tensor, octaves: int) -> Tensor:
    """Return x, and sine and cosine of π 2ᵏ x, [P, C (1 + 2 octaves)]."""
    waves = [x * (math.pi * 2**k) for k in range(octaves)]
    return torch.cat([x, *(f(w) for w in waves for f in (torch.sin, torch.cos))], 1)


def spread(points: Tensor, count: int) -> Tensor:
    """Return indices of `count` points of [N, 3], each the farthest from those before; the first is point 0."""
    chosen = [0]
    distance = (points - points[0]).square().sum(1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(distance.argmax()))
        distance = torch.minimum(distance, (points - points[chosen[-1]]).square().sum(1))
    return torch.tensor(chosen)
