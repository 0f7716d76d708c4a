"""Memory: arrays that need not fit into it, buffers that are used again, and the peak of this process.

A large array lies in a temporary file of which few pages are held at a time. `release` lets go of the pages that were
read or written, so that resident memory follows what is worked on. The file has no name in its folder and is gone with
the array, also after a kill. The folder is $TMPDIR, else /var/tmp where that is there: /tmp lies in memory on many
systems.
"""

import mmap
import os
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import DTypeLike

IN_MEMORY = 1 << 28  # bytes of an array: more lies in a file
_ON_DISK = Path("/var/tmp")
_SPARE = 1.25  # a buffer that must grow gets so much more than is asked


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
    """Reset the peak to the present memory. Return False if the system cannot (all but Linux)."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return False
    return True


def mapped_zeros(
    shape: tuple[int, ...],
    dtype: DTypeLike = np.float32,
    folder: Path | None = None,
    in_memory: int | None = None,
) -> np.ndarray:
    """Zeros [*shape], in memory up to `in_memory` bytes (`IN_MEMORY`), else in a file of `folder`.

    Raises OSError, with the folder, where the disk has no room for it.
    """
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    if size <= (IN_MEMORY if in_memory is None else in_memory):
        return np.zeros(shape, dtype)
    where = folder or _folder() or Path(tempfile.gettempdir())
    with tempfile.TemporaryFile(dir=where, prefix=".tg4mm") as file:
        reserve(file.fileno(), size, where)
        return np.asarray(np.memmap(file, dtype, "w+", shape=shape))


def reserve(descriptor: int, size: int, where: Path) -> None:
    """Give an open file its `size` bytes on disk. Raises OSError, which names `where`, if there is no room.

    A file that is mapped without them kills the process where the disk turns out to be full (SIGBUS).
    """
    if not hasattr(os, "posix_fallocate"):
        return
    try:
        os.posix_fallocate(descriptor, 0, size)
    except OSError as error:
        message = f"{error.strerror} for {size / 2**20:,.0f} MiB of temporary arrays"
        raise OSError(error.errno, message, str(where)) from None


def release(array: np.ndarray) -> None:
    """Let go of the pages held of an array that `mapped_zeros` made, or of a view of one; of others do nothing.

    Its contents stay: they are read again from the file, or from the system's cache of it.
    """
    base = array.base
    while isinstance(base, np.ndarray):
        base = base.base
    if isinstance(base, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        base.madvise(mmap.MADV_DONTNEED)


def _folder() -> Path | None:
    """Return the folder of temporary files; None for the system's choice."""
    if "TMPDIR" in os.environ or not (_ON_DISK.is_dir() and os.access(_ON_DISK, os.W_OK)):
        return None
    return _ON_DISK


class Buffers:
    """Arrays by name. One asked for again lies where the last of that name lay, whose contents it overwrites."""

    def __init__(self) -> None:
        self._held: dict[str, np.ndarray] = {}

    def take(self, name: str, shape: tuple[int, ...], dtype: DTypeLike = np.float32) -> np.ndarray:
        """An array [*shape] of undefined contents; the first 64 bytes of it start a cache line."""
        kind = np.dtype(dtype)
        size = int(np.prod(shape)) * kind.itemsize
        held = self._held.get(name)
        if held is None or len(held) < size:
            held = self._held[name] = _aligned(int(size * _SPARE) if held is not None else size)
        return held[:size].view(kind).reshape(shape)


def _aligned(size: int) -> np.ndarray:
    room = np.empty(size + 64, np.uint8)
    skip = -room.ctypes.data % 64
    return room[skip : skip + size]
