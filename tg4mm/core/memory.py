"""Peak memory of this process, so that every stage can say what it needed."""

from __future__ import annotations

import sys
from pathlib import Path


def peak_memory_mib() -> float:
    """The most resident memory this process has held, MiB, since it began or since `reset_peak_memory`."""
    # Linux: VmHWM, since ru_maxrss is inherited from the parent through fork and exec and cannot be reset.
    status = Path("/proc/self/status")
    if status.is_file():
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM:"))
        return int(line.split()[1]) / 1024
    if sys.platform == "win32":
        import psutil

        return psutil.Process().memory_info().peak_wset / (1 << 20)
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1 << 20)  # macOS counts in bytes


def reset_peak_memory() -> bool:
    """Start the peak anew from what is held now. False where the system has no such thing (not Linux)."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return False
    return True
