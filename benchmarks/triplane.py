"""Sampling a triplane at fixed points, forward and backward, and an Adam step: dense planes in torch, and active cells.

    python -m benchmarks.triplane [--points 5000,50000] [--resolution 64,512] [--channels 32] [--repeats 5]

`grid_sample`: torch on dense planes [3, C, R, R], as published code does. `torch gather`: torch's own indexing of the
active cells. `numba`: ours. All three compute the same (tests/research/paper/triplane/test_sample.py).
"""

from __future__ import annotations

import tg4mm  # noqa: F401, before torch and numba: how their threads wait

# isort: split

import argparse
from collections.abc import Callable

import numpy as np
import torch
from torch.nn.functional import grid_sample

from benchmarks.common import machine, milliseconds
from tg4mm.research.paper.triplane import cells_of, sample
from tg4mm.research.paper.triplane.cells import PLANES, scene_box
from tg4mm.research.paper.triplane.sample import sample_torch


def surface_points(n: int, rng: np.random.Generator) -> np.ndarray:
    """Points on two spheres: planes are touched unevenly, as by a scene."""
    p = rng.standard_normal((n, 3))
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    return np.where(rng.random((n, 1)) < 0.5, p, 0.4 * p + [0.8, 0.3, 0.2])


def dense(planes: torch.Tensor, grids: list[torch.Tensor]) -> torch.Tensor:
    parts = [
        grid_sample(planes[k : k + 1], grid, "bilinear", "border", True)[0, :, 0].T
        for k, grid in enumerate(grids)
    ]
    return torch.cat(parts, 1)


def row(
    name: str, parameters: torch.Tensor, sampled: Callable[[], torch.Tensor], v: torch.Tensor, repeats: int
) -> str:
    """Median milliseconds of forward, forward with backward, and a step of Adam after it."""
    adam = torch.optim.Adam([parameters], lr=1e-4, fused=True)

    def both() -> None:
        parameters.grad = None
        sampled().backward(v)

    def step() -> None:
        both()
        adam.step()

    with torch.no_grad():
        forward = milliseconds(sampled, repeats)[0]
    times = [forward, *(milliseconds(call, repeats)[0] for call in (both, step))]
    return f"  {name:<14}" + "".join(f"{t:12.2f}" for t in times)


def compare(n: int, resolution: int, channels: int, repeats: int) -> None:
    """Print the three rows for one size."""
    points = surface_points(n, np.random.default_rng(0))
    box = scene_box(points)
    cells = cells_of(points, box, resolution)
    unit = torch.from_numpy((points - box[0]) / (box[1] - box[0]) * 2 - 1).float()
    grids = [unit[:, list(axes)][None, None].contiguous() for axes in PLANES]
    planes = torch.randn(3, channels, resolution, resolution).requires_grad_()
    values = torch.randn(len(cells), channels).requires_grad_()
    v = torch.randn(n, 3 * channels)
    share = len(cells) / (3 * resolution**2)
    print(f"{n} points, 3 × {channels} × {resolution}², {len(cells)} active cells ({share:.1%})")
    print(f"  {'':<14}{'forward':>12}{'+ backward':>12}{'+ Adam':>12}   ms")
    print(row("grid_sample", planes, lambda: dense(planes, grids), v, repeats))
    print(row("torch gather", values, lambda: sample_torch(values, cells), v, repeats))
    print(row("numba", values, lambda: sample(values, cells), v, repeats))


def main() -> None:
    """Print a table for every size."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", default="5000,50000")
    parser.add_argument("--resolution", default="64,512")
    parser.add_argument("--channels", type=int, default=32)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    print(machine())
    for n in map(int, options.points.split(",")):
        for resolution in map(int, options.resolution.split(",")):
            compare(n, resolution, options.channels, options.repeats)


if __name__ == "__main__":
    main()
