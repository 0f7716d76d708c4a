"""Time of the first picture in a fresh process: kernels compiled (cold cache) and read from the cache (warm).

    python -m benchmarks startup [--repeats 3]

The last column is the processor time from the start of Python to the first picture: on a machine that does nothing
else about the time by the clock, on a shared one what that would be.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.common import machine

_SCRIPT = """
import time
start = time.perf_counter()
import tg4mm
import torch
from tg4mm.fit.rasterize import rasterization
imported = time.perf_counter()
n = 1000
g = [torch.randn(n, 3), torch.randn(n, 4), torch.full((n, 3), 0.01), torch.full((n,), 0.5), torch.randn(n, 16, 3)]
g = [a.requires_grad_() for a in g]
view, K = torch.eye(4), torch.tensor([[100.0, 0, 64], [0, 100, 64], [0, 0, 1]])
view[2, 3] = 4
image, _, _ = rasterization(*g, view[None], K[None], 128, 128, sh_degree=3)
forward, used = time.perf_counter(), time.process_time()
image.sum().backward()
print(imported - start, forward - imported, time.perf_counter() - forward, used)
"""


def first_call(cache: Path) -> list[float]:
    """Seconds of import, forward, backward, and of processor time up to the picture.

    In a fresh process that keeps its kernels in `cache`.
    """
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run(
        [sys.executable, "-c", _SCRIPT], env=environment, check=True, capture_output=True, text=True
    )
    return [float(x) for x in done.stdout.split()]


OPTIONS = {"--repeats": 3}  # of the warm cache


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    print(machine())
    print(f"{'cache':8s} {'import':>8s} {'forward':>8s} {'backward':>8s} {'processor':>9s}  s")
    with tempfile.TemporaryDirectory() as folder:
        cold = first_call(Path(folder))
        warm = [first_call(Path(folder)) for _ in range(options.repeats)]
    for name, times in (("cold", cold), ("warm", [statistics.median(t) for t in zip(*warm, strict=True)])):
        print(f"{name:8s} " + " ".join(f"{t:8.2f}" for t in times))
