"""Parts that the benchmarks share: the machine, costs of calls and of programs, a table of found and true values."""

import os
import platform
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numba
import torch

from tg4mm.core.errors import Tg4mmError


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


def timed(calls: dict[str, Callable[[], object]], repeats: int, each: int) -> dict[str, Times]:
    """Times of every call: `each` of one, then of the next, round after round.

    What slows the machine down for a while falls to all of them. Every turn begins with a call that is not counted: it
    fetches what the one before has driven out of the caches.
    """
    rounds = -(-repeats // each)
    times = {name: Times([], []) for name in calls}
    for n in range(rounds):
        for name, call in calls.items():
            call()
            for _ in range(repeats * n // rounds, repeats * (n + 1) // rounds):
                clock, processor = time.perf_counter(), time.process_time()
                call()
                times[name].clock.append((time.perf_counter() - clock) * 1e3)
                times[name].processor.append((time.process_time() - processor) * 1e3)
    return times


class Cost(NamedTuple):
    """Costs of a program with those that it started."""

    processor_s: float
    clock_s: float
    gib: float  # at most, of one process


def cost(words: Sequence[str], environment: Mapping[str, str] | None = None) -> Cost:
    """Run a program. Raises Tg4mmError with its last words where it fails."""
    began = time.monotonic()
    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen(words, stdout=output, stderr=output, env=environment)
        _, process.returncode, used = os.wait4(process.pid, 0)
        if process.returncode:
            output.seek(0)
            raise Tg4mmError(f"{' '.join(words)}: {output.read().decode(errors='replace')[-2000:]}")
    return Cost(used.ru_utime + used.ru_stime, time.monotonic() - began, used.ru_maxrss / 2**20)


def print_found(rows: Sequence[tuple[str, float, float, float]]) -> None:
    """Print a table of (label, found, its standard deviation, truth)."""
    print(f"{'':32s}{'found':>12s}{'±':>10s}{'truth':>12s}{'errors in ±':>13s}")
    for name, value, deviation, true in rows:
        print(f"{name:32s}{value:12.6g}{deviation:10.2g}{true:12.6g}{(value - true) / deviation:13.1f}")
