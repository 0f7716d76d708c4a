"""What a reader is asked, and what it tells of a file before its data are read."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..errors import SplatFileError

Decode = Callable[
    [bytes], np.ndarray
]  # a lossless WebP → [H, W, 4] uint8, first row at the top; raises ValueError


@dataclass(frozen=True)
class Options:
    """What the one who opens a file adds to it."""

    freqs_hz: tuple[float, ...] = ()  # of the modes of a PLY that lost the line which says them
    fps: float = 30.0  # Hz, of that motion
    decode: Decode | None = None  # of SOG's pictures; None: Pillow


@dataclass(frozen=True)
class Head:
    """What a file says before its data are read."""

    kind: str  # such as "PLY" or "SPZ 3"
    count: int  # Gaussians
    n_modes: int = 0  # whose frequencies it says
    n_lost: int = 0  # modes whose frequencies it does not say
    y_up: bool = False  # the format's axes, Y up, which reading turns to Z up; else they are as in the file


def parsed_frequencies(text: str) -> tuple[float, ...]:
    """`"5, 7.5"` as (5.0, 7.5), Hz. Raises SplatFileError naming what is no frequency."""
    found = []
    for word in text.replace(";", " ").replace(",", " ").split():
        try:
            value = float(word)
        except ValueError:
            value = math.nan
        if not 0 <= value < math.inf:
            raise SplatFileError(
                f"frequencies {text!r}: {word!r} is none; expected numbers in Hz such as 5, 7.5"
            )
        found.append(value)
    return tuple(found)
