"""The complex steerable pyramid as transfer functions, one sub-band at a time.

plenoptic's `SteerablePyramidFreq` [Simoncelli & Freeman 1995] makes the pyramid; its answers to impulses are the
transfer functions of analysis and synthesis, exactly. With them a sub-band of many images can be computed, changed and
put back without ever holding a whole pyramid: 8 bytes · orientations · (1 + 1/4 + …) ≈ 85 a pixel, 23 MB at 512².
"""

from __future__ import annotations

import warnings
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from tg4mm.core.errors import Tg4mmError

SMALLEST = 16  # below, "auto" leaves less than two scales


@dataclass(frozen=True)
class PyramidConfig:
    """[TG4MM] §IV.B: eight orientations, as many scales as the size allows, transition width 0.75 octaves.

    plenoptic (2.1) cuts the width to whole octaves: 0.75 acts as 0, that is, sharp edges of the radial bands.
    """

    orientations: int = 8
    twidth: float = 0.75


@dataclass(frozen=True)
class SubBand:
    """One scale and orientation; its coefficients are ifft2(crop(fft2(image)) · analysis), complex."""

    scale: int
    orientation: int
    analysis: Tensor  # [h, w] complex64, frequencies in the FFT's order
    synthesis: (
        Tensor  # [h, w] complex64: its part of an image is Re ifft2(pad(fft2(coefficients) · synthesis))
    )


def pyramid(shape: tuple[int, int], config: PyramidConfig) -> Any:
    """plenoptic's pyramid for images of `shape` (rows, columns).

    Raises Tg4mmError for sizes it is not exact for (odd, not alike when halved) or too small.
    """
    from plenoptic.process import SteerablePyramidFreq

    for size in shape:
        if size < SMALLEST or size & (size - 1):
            raise Tg4mmError(
                f"phase: planes of {shape[0]}×{shape[1]} cells, expected powers of two of at least {SMALLEST}"
            )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return SteerablePyramidFreq(
            shape, height="auto", order=config.orientations - 1, twidth=config.twidth,
            is_complex=True, downsample=True,
        )  # fmt: skip


@torch.no_grad()
def sub_bands(shape: tuple[int, int], config: PyramidConfig | None = None) -> Iterator[SubBand]:
    """All oriented sub-bands of images of `shape`, finest first; the residuals hold no phase and are not among them."""
    config = config or PyramidConfig()
    made = pyramid(shape, config)
    impulse = torch.zeros(1, 1, *shape)
    impulse[..., 0, 0] = 1
    answers = made(impulse)
    scales = [k for k in answers if isinstance(k, int)]
    for scale in scales:
        analysis = torch.fft.fft2(answers[scale][0, 0])
        poke = torch.zeros_like(answers[scale])
        poke[..., 0, 0] = 1  # every orientation: `bands` picks one
        poked = OrderedDict(answers | {scale: poke})
        for o in range(config.orientations):
            # Synthesis filters are real in space: one impulse tells all.
            back = made.recon_pyr(poked, levels=[scale], bands=[o])[0, 0]
            yield SubBand(scale, o, analysis[o].clone(), crop(torch.fft.fft2(back), analysis.shape[-2:]))


def crop(spectrum: Tensor, size: tuple[int, int]) -> Tensor:
    """The lowest (h, w) frequencies of spectra [..., H, W] in the FFT's order: −h/2 … h/2 − 1."""
    h, w = size
    rows = [slice(0, h // 2), slice(spectrum.shape[-2] - h // 2, None)]
    columns = [slice(0, w // 2), slice(spectrum.shape[-1] - w // 2, None)]
    return torch.cat([torch.cat([spectrum[..., r, c] for c in columns], -1) for r in rows], -2)
