"""The sub-bands with which phase-based video magnification was published [PVM]: half an octave wide.

Narrower than those of the complex steerable pyramid (`phase.py`), so that phase may grow twice as far before it leaves
the range in which it stands for a shift ([PVM] §3.3). Eight orientations, radial windows that fall by a raised cosine
of 0.75 octaves: the settings of its authors' program.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import torch
from torch import Tensor

from tg4mm.core.errors import Tg4mmError
from tg4mm.fit.magnify.phase import SMALLEST, SubBand, crop

_ORIENTATIONS = 8
_PER_OCTAVE = 2
_FALL = 0.75  # octaves over which a window falls
_LEFT_OUT = 2  # octaves at the coarse end, which stay as they are


def half_octave_bands(shape: tuple[int, int]) -> Iterator[SubBand]:
    """All oriented sub-bands of images of `shape`, finest first, each cropped to the frequencies that it holds.

    Put back they give the image but for the finest and the coarsest frequencies, to 0.5 %. Raises Tg4mmError for an odd
    or too small size.
    """
    if any(size < SMALLEST or size % 2 for size in shape):
        raise Tg4mmError(
            f"pictures of {shape[0]}×{shape[1]} pixels, expected even sizes of at least {SMALLEST}"
        )
    y, x = (2 * torch.fft.fftfreq(size, dtype=torch.float64) for size in shape)
    radius, angle = torch.hypot(y[:, None], x), torch.atan2(y[:, None], x[None])
    octaves = int(math.log2(min(shape))) - _LEFT_OUT
    edges = [2 ** (-k / _PER_OCTAVE) for k in range(octaves * _PER_OCTAVE + 1)]
    for scale, (outer, inner) in enumerate(pairwise(edges)):
        ring = _below(radius, outer) * torch.sqrt(1 - _below(radius, inner) ** 2)
        size = tuple(min(2 * math.ceil(n * outer / 2 + 1), n) for n in shape)
        for o in range(_ORIENTATIONS):
            window = crop(ring * _towards(angle, math.pi * o / _ORIENTATIONS), (size[0], size[1])).to(
                torch.complex64
            )
            yield SubBand(scale, o, window, window)


def _below(radius: Tensor, edge: float) -> Tensor:
    """1 at radii up to `edge` less `_FALL` octaves, 0 from `edge` on, a quarter of a sine between."""
    octaves = torch.log2(edge / radius.clamp_min(1e-9)).clamp(0, _FALL)
    return torch.sin(octaves * (math.pi / 2 / _FALL))


def _towards(angle: Tensor, direction: float) -> Tensor:
    """The half-plane around `direction`: cosⁿ⁻¹; the squares of all and of their mirror images add up to 2."""
    n = _ORIENTATIONS - 1
    size = 2**n * math.factorial(n) / math.sqrt(_ORIENTATIONS * math.factorial(2 * n))
    return math.sqrt(2) * size * torch.cos(angle - direction).clamp_min(0) ** n
