"""What the benchmarks share: the machine's description, and the time of a call."""

from __future__ import annotations

import os
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numba
import torch


def machine() -> str:
    """Host name, processor, load and threads in use."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    processor = names[0] if names else platform.processor() or platform.machine()
    threads = f"{numba.get_num_threads()} numba threads, {torch.get_num_threads()} torch threads"
    policy = os.environ.get("OMP_WAIT_POLICY", "unset")
    load = f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    return f"{platform.node()}: {processor}, {threads}, OMP_WAIT_POLICY {policy}, {load}"


def milliseconds(call: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Median and smallest time of `call`, after one call that loads or compiles."""
    call()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append((time.perf_counter() - start) * 1e3)
    return statistics.median(times), min(times)


def processor_milliseconds(call: Callable[[], object], repeats: int) -> float:
    """Smallest processor time of `call`, after one call that loads or compiles.

    With one thread it hardly depends on what else the machine does, unlike time by the clock. With more it is no sum:
    the system books short work of other threads late.
    """
    call()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        times.append((time.process_time() - start) * 1e3)
    return min(times)
