"""The order of Gaussians in memory: neighbours in space are neighbours there, so that a tile reads few pages."""

from __future__ import annotations

import torch
from torch import Tensor

from tg4mm.fit.space import density

EVERY = 10  # rounds of density control, between which halves take places anywhere
# Shifts and masks after which two zeros follow each of a number's 21 bits
_SPREAD = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def is_due(iteration: int, until: float) -> bool:
    """Whether rows are brought into order after this round of density control: now and then, and after the last."""
    return iteration % (EVERY * density.EVERY) == 0 or iteration + density.EVERY >= until


def along_a_curve(means: Tensor) -> Tensor:
    """The order [N] of means [N, 3] along a Morton curve, on which most neighbours in space are neighbours."""
    if len(means) == 0:
        return torch.arange(0, device=means.device)
    low, high = means.amin(0), means.amax(0)
    cells = ((means - low) / (high - low).clamp_min(1e-30) * (2**21 - 1)).long()
    for shift, mask in _SPREAD:
        cells = (cells | cells << shift) & mask
    return torch.argsort(cells[:, 0] | cells[:, 1] << 1 | cells[:, 2] << 2, stable=True)
