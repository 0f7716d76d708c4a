"""SPZ version 3: one moment of a scene in some 20 bytes a Gaussian, gzip-compressed. It holds no motion.

The layout is that of the reference library (github.com/nianticlabs/spz), whose axes are x right, Y up, z backwards.
"""

from __future__ import annotations

import gzip
import math
import struct
from pathlib import Path

import numpy as np

from ..errors import SplatFileError
from . import layout
from .axes import y_up
from .model import SplatFile
from .write import replacing

MAGIC, _VERSION = 0x5053474E, 3
_MOST_BITS = 23  # after the binary point; a position has 24 with its sign
_LARGEST = 2**23 - 1  # what a position of 24 bits holds
COLOUR = 0.15  # of the range of a byte, for a change of 1 in f_dc
_LEVEL = 6  # of compression


def write_spz(path: str | Path, splat: SplatFile) -> None:
    """Write the scene at rest; its motion is left out. Replaces `path` in one step.

    Positions are kept to 2⁻²⁴ of the scene's size: the grid is as fine as 24 bits allow, not the 1/4096 that is
    usual, which would be as coarse as a subtle motion. Scales are kept to 3 % (e⁻¹⁰ to e⁶), turns to 0.1°,
    opacities to 1/510, colours to 0.013 in f_dc (±3.3) and 0.004 in further coefficients (±1).
    Raises SplatFileError if the file cannot be written, or for positions beyond ±8.4 million.
    """
    with replacing(Path(path)) as temporary:
        temporary.write_bytes(gzip.compress(_content(y_up(splat)), _LEVEL, mtime=0))


def _content(splat: SplatFile) -> bytes:
    reach = float(np.abs(splat.means).max())
    if reach > _LARGEST:
        raise SplatFileError(
            f"a position is {reach:g} scene units off the origin; spz holds up to {_LARGEST}"
        )
    bits = _MOST_BITS if reach == 0 else min(_MOST_BITS, math.floor(math.log2(_LARGEST / reach)))
    head = struct.pack("<IIIBBBB", MAGIC, _VERSION, len(splat), splat.sh_degree, bits, 0, 0)
    fixed = np.round(splat.means.astype(np.float64) * 2.0**bits).astype("<i4")
    sections = (
        np.ascontiguousarray(fixed).view(np.uint8).reshape(-1, 3, 4)[:, :, :3],
        _bytes(255.0 * splat.opacities),
        _bytes(255.0 * (COLOUR * splat.sh[:, 0] + 0.5)),
        _bytes(16.0 * (layout.log_scale(splat.scales) + 10.0)),
        smallest_three(splat.quats),
        _bytes(128.0 * (splat.sh[:, 1:] + 1.0)),
    )
    return head + b"".join(section.tobytes() for section in sections)


def _bytes(values: np.ndarray) -> np.ndarray:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


def smallest_three(quats: np.ndarray) -> np.ndarray:
    """[N] uint32: which of x, y, z, w is largest in the 2 highest bits, then sign and 9 bits of each other one.

    quats [N, 4] wxyz of any length but 0.
    """
    xyzw = quats.astype(np.float64)[:, [1, 2, 3, 0]]
    xyzw /= np.linalg.norm(xyzw, axis=1, keepdims=True)
    rows, largest = np.arange(len(xyzw)), np.abs(xyzw).argmax(axis=1)
    xyzw *= np.where(xyzw[rows, largest] < 0, -1.0, 1.0)[:, None]
    packed = largest.astype(np.uint32)
    for i in range(4):
        size = np.minimum(np.round(511.0 * math.sqrt(2.0) * np.abs(xyzw[:, i])), 511).astype(np.uint32)
        one = (xyzw[:, i] < 0).astype(np.uint32) << np.uint32(9) | size
        packed = np.where(largest == i, packed, packed << np.uint32(10) | one)
    return packed.astype("<u4")
