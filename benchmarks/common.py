"""Parts that the benchmarks share: the machine's description, times of calls, a table of found and true values."""

import os
import platform
import statistics
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

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


class Times(NamedTuple):
    """Milliseconds of a call, several times.

    Processor time with one thread hardly depends on what else the machine does, unlike time by the clock. With more it
    is no sum: the system books short work of other threads late.
    """

    clock: list[float]
    processor: list[float]

    @property
    def median(self) -> float:
        return statistics.median(self.clock)

    @property
    def least(self) -> float:
        return min(self.clock)


def timed(calls: dict[str, Callable[[], object]], repeats: int, each: int = 1) -> dict[str, Times]:
    """Times of every call: `each` of one, then of the next, round after round, after one that is not counted.

    What slows the machine down for a while falls to all of them. With `each` above 1 every turn begins with a call that
    is not counted: it fetches what the one before has driven out of the caches.
    """
    rounds = -(-repeats // each)
    times = {name: Times([], []) for name in calls}
    for n in range(rounds):
        for name, call in calls.items():
            if each > 1 or not n:
                call()
            for _ in range(repeats * n // rounds, repeats * (n + 1) // rounds):
                clock, processor = time.perf_counter(), time.process_time()
                call()
                times[name].clock.append((time.perf_counter() - clock) * 1e3)
                times[name].processor.append((time.process_time() - processor) * 1e3)
    return times


def print_found(rows: Sequence[tuple[str, float, float, float]]) -> None:
    """Print a table of (label, found, its standard deviation, truth)."""
    print(f"{'':32s}{'found':>12s}{'±':>10s}{'truth':>12s}{'errors in ±':>13s}")
    for name, value, deviation, true in rows:
        print(f"{name:32s}{value:12.6g}{deviation:10.2g}{true:12.6g}{(value - true) / deviation:13.1f}")
