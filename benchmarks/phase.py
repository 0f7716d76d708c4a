"""Phase magnification of one video: time and peak memory beside the bound that tg4mm/fit/magnify/phase.py states.

    python -m benchmarks.phase [--timesteps 300] [--size 512]

Linux only, since it resets the peak of resident memory between making the filters and magnifying.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

import numpy as np

from benchmarks.common import machine
from tg4mm.core.filters import TemporalFilter, bins
from tg4mm.core.memory import peak_memory_mib, reset_peak_memory
from tg4mm.fit.magnify.phase import PhaseMagnifier

FPS = 30.0


def resident_mib() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def main() -> None:
    """Print what it took."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--timesteps", type=int, default=300)
    parser.add_argument("--size", type=int, default=512)
    options = parser.parse_args()
    n, size = options.timesteps, options.size
    print(machine())
    response = 20 * TemporalFilter().response((3.5, 6.5), bins(n, FPS), FPS)
    began = time.monotonic()
    magnify = PhaseMagnifier((size, size), response)
    print(f"filters of {size}²: {time.monotonic() - began:.1f} s, once")
    before = resident_mib()
    rng = np.random.default_rng(0)
    video = rng.standard_normal((n, size, size), np.float32)
    reset_peak_memory()
    began = time.monotonic()
    magnify(video)
    seconds = time.monotonic() - began
    cells = video.size
    print(
        f"{n} × {size}²: {seconds:.1f} s, {seconds / n * 1e3:.0f} ms a frame; peak "
        f"{peak_memory_mib() - before:.0f} MiB above what the filters hold; "
        f"bound 20 bytes × {cells} + 100 MB = {(20 * cells + 1e8) / 2**20:.0f} MiB"
    )


if __name__ == "__main__":
    main()
