"""Time of the CPU rasteriser, forward and backward, and beside it the dense twin at a size it can bear.

    python benchmarks/rasterize.py [--repeats 7]

Gaussians of about two pixels (standard deviation) fill a ball seen from outside. Each figure is the median;
the smallest time of the same runs stands in brackets: on a shared machine the two lie apart, and with
OMP_WAIT_POLICY unset they lie far apart, because idle OpenMP threads spin.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numba
import torch
from torch import Tensor

from tg4mm.rasterize import rasterization
from tg4mm.rasterize.reference import rasterize_dense

SIZES = (256, 512)  # pixels
COUNTS = (5_000, 50_000, 200_000)  # Gaussians
DENSE_SIZE, DENSE_COUNT = 64, 500
DISTANCE, PIXELS = (
    3.0,
    2.0,
)  # scene units from the camera to the ball's centre; standard deviation of a Gaussian


def scene(n: int, size: int, seed: int = 0) -> tuple[list[Tensor], Tensor, Tensor]:
    """Parameters (means … sh of degree 3) of n Gaussians in the unit ball, viewmat [4, 4] and K [3, 3]."""
    rng = torch.Generator().manual_seed(seed)
    direction = torch.nn.functional.normalize(torch.randn(n, 3, generator=rng), dim=-1)
    means = direction * torch.rand(n, 1, generator=rng) ** (1 / 3)
    focal = 1.2 * size
    scales = PIXELS * DISTANCE / focal * torch.exp(0.6 * torch.randn(n, 3, generator=rng).clamp(-2, 2))
    parameters = [
        means,
        torch.randn(n, 4, generator=rng),
        scales,
        torch.rand(n, generator=rng) * 0.9 + 0.05,
        torch.randn(n, 16, 3, generator=rng) * 0.2,
    ]
    viewmat = torch.eye(4)
    viewmat[2, 3] = DISTANCE
    return parameters, viewmat, torch.tensor([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1.0]])


def ours(parameters: list[Tensor], viewmat: Tensor, K: Tensor, size: int) -> tuple[Tensor, int]:
    """The image [H, W, 3] and the number of tile pairs."""
    means, quats, scales, opacities, sh = parameters
    image, _, meta = rasterization(
        means, quats, scales, opacities, sh, viewmat[None], K[None], size, size, sh_degree=3
    )
    return image[0], len(meta["projected"][0].bins.pair_gaussian)


def dense(parameters: list[Tensor], viewmat: Tensor, K: Tensor, size: int) -> tuple[Tensor, int]:
    """The same image by the twin; its pairs are all there are."""
    means, quats, scales, opacities, sh = parameters
    image, _ = rasterize_dense(means, quats, scales, opacities, sh, viewmat, K, size, size)
    return image, len(parameters[0]) * (size // 16) ** 2


def measure(render: Callable[..., tuple[Tensor, int]], n: int, size: int, repeats: int) -> dict[str, float]:
    """Milliseconds of both passes (median and smallest) and the number of pairs."""
    parameters, viewmat, K = scene(n, size)
    parameters = [p.requires_grad_() for p in parameters]
    weight = torch.randn(size, size, 3, generator=torch.Generator().manual_seed(1))
    forward, backward, pairs = [], [], 0
    for _ in range(repeats + 1):
        start = time.perf_counter()
        image, pairs = render(parameters, viewmat, K, size)
        middle = time.perf_counter()
        image.backward(weight)
        forward.append((middle - start) * 1e3)
        backward.append((time.perf_counter() - middle) * 1e3)
    forward, backward = forward[1:], backward[1:]  # the first call loads or compiles the kernels
    return {
        "forward": statistics.median(forward), "forward_min": min(forward),
        "backward": statistics.median(backward), "backward_min": min(backward), "pairs": pairs,
    }  # fmt: skip


def row(name: str, n: int, size: int, t: dict[str, float]) -> str:
    return (
        f"{name:6s} {n:8d} {size:4d}² {t['pairs']:9.0f} {t['forward']:8.1f} [{t['forward_min']:.1f}] "
        f"{t['backward']:8.1f} [{t['backward_min']:.1f}]"
    )


def machine() -> str:
    """Host name, processor and threads in use."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    processor = names[0] if names else platform.processor() or platform.machine()
    threads = f"{numba.get_num_threads()} numba threads, {torch.get_num_threads()} torch threads"
    policy = os.environ.get("OMP_WAIT_POLICY", "unset")
    return f"{platform.node()}: {processor}, {threads}, OMP_WAIT_POLICY {policy}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=7)
    repeats = parser.parse_args().repeats
    print(machine())
    print(f"{'':6s} {'N':>8s} {'size':>5s} {'pairs':>9s}  forward [min] ms  backward [min] ms")
    for size in SIZES:
        for n in COUNTS:
            print(row("ours", n, size, measure(ours, n, size, repeats)), flush=True)
    small = measure(ours, DENSE_COUNT, DENSE_SIZE, repeats)
    twin = measure(dense, DENSE_COUNT, DENSE_SIZE, repeats)
    print(row("ours", DENSE_COUNT, DENSE_SIZE, small))
    print(row("dense", DENSE_COUNT, DENSE_SIZE, twin))
    ratios = [twin[key] / small[key] for key in ("forward", "backward")]
    print(f"the dense twin takes {ratios[0]:.0f} times as long forward, {ratios[1]:.0f} times backward")


if __name__ == "__main__":
    main()
