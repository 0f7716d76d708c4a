"""Memory that is used again: arrays by name which grow and are not returned to the system between calls."""

import numpy as np
from numpy.typing import DTypeLike

_SPARE = 1.25  # a buffer that must grow gets so much more than is asked


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
