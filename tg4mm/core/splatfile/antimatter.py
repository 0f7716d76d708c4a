""".splat, of antimatter15's viewer: 32 bytes a Gaussian and nothing else, so that a file cut between two is one.

Position and linear scale as float32, colour and opacity, rotation wxyz as bytes. Axes are those of the PLY that it was
made of.
"""

from __future__ import annotations

from typing import BinaryIO

import numpy as np

from ..errors import SplatFileError
from . import layout
from .drawable import Head, drawable
from .model import SplatFile

_RECORD = np.dtype([("place", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("turn", "u1", 4)])


def head_of_splat(size: int) -> Head:
    """What the length of a file says."""
    if size == 0 or size % _RECORD.itemsize:
        raise SplatFileError(
            f"is {size} bytes long; a .splat has {_RECORD.itemsize} a Gaussian: it is cut off, or something else"
        )
    return Head(".splat", size // _RECORD.itemsize)


def read_antimatter(file: BinaryIO, size: int) -> SplatFile:
    """The Gaussians of a .splat. SplatFileError without the file's name."""
    count = head_of_splat(size).count
    records = np.fromfile(file, _RECORD, count)
    if len(records) != count:
        raise SplatFileError(f"is truncated: {len(records)} Gaussians, expected {count}")
    rgba = records["rgba"] / np.float32(255)
    fields = {
        "means": records["place"],
        "quats": records["turn"] / np.float32(128) - 1,
        "scales": records["scale"],
        "opacities": rgba[:, 3],
        "sh": layout.f_dc(rgba[:, None, :3]),
    }
    return drawable(fields)
