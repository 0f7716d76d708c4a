"""The space stage's loss, and gains for pictures with different exposure."""

from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import conv2d

_SIGMA, _RADIUS = 1.5, 5  # SSIM's 11 × 11 window
_C1, _C2 = 0.01**2, 0.03**2
RATE = 0.1  # of the way, each time
GAIN_EVERY = 4  # pixels: one of so many in each direction is looked at
BRIGHTEST = 250 / 255  # what is brighter may have been clipped, whatever the exposure
MOST = 4.0  # and 1 / MOST: no gain lies further from one


def ssim(a: Tensor, b: Tensor) -> Tensor:
    """Mean structural similarity of two images [H, W, 3] in 0..1, differentiable; Gaussian window, zero border."""
    planes = torch.cat([x.permute(2, 0, 1) for x in (a, b, a * a, b * b, a * b)])[None]
    x = torch.arange(-_RADIUS, _RADIUS + 1, dtype=planes.dtype, device=planes.device)
    g = torch.exp(-(x**2) / (2 * _SIGMA**2))
    window = (g / g.sum()).expand(planes.shape[1], 1, -1)
    blurred = conv2d(planes, window[:, :, :, None], padding=(_RADIUS, 0), groups=planes.shape[1])
    blurred = conv2d(blurred, window[:, :, None, :], padding=(0, _RADIUS), groups=planes.shape[1])
    ma, mb, saa, sbb, sab = blurred[0].split(a.shape[-1])
    va, vb, cov = saa - ma * ma, sbb - mb * mb, sab - ma * mb
    return (((2 * ma * mb + _C1) * (2 * cov + _C2)) / ((ma**2 + mb**2 + _C1) * (va + vb + _C2))).mean()


def photometric_loss(rendered: Tensor, target: Tensor, l2: float, dssim: float) -> Tensor:
    """Return (1 − λ) (L1 + l2 · MSE) + λ (1 − SSIM) / 2 of images [H, W, 3]; [TG4MM] Eq. (16) where l2 = λ = 0."""
    difference = rendered - target
    loss = difference.abs().mean()
    if l2 > 0:
        loss = loss + l2 * (difference * difference).mean()
    if dssim > 0:
        loss = (1 - dssim) * loss + dssim * (1 - ssim(rendered, target)) / 2
    return loss


def fitting_gain(rendered: Any, target: Any) -> Any:
    """Return [3] gains that bring `rendered` closest to `target`, both [H, W, 3], torch tensors or numpy arrays.

    Least squares over the pixels that are not clipped; where there are none, 1.
    """
    seen = target < BRIGHTEST
    squares = (rendered * rendered * seen).sum((0, 1))
    return ((rendered * target * seen).sum((0, 1)) + 1e-6) / (squares + 1e-6)


def with_gain(gains: Tensor, v: int, fitting: Tensor) -> Tensor:
    """Gains [V, 3] after picture v was seen, which `fitting` [3] would suit best."""
    logs = gains.log()
    logs[v] += RATE * (fitting.clamp(1 / MOST, MOST).log() - logs[v])
    return (logs - logs.mean(0)).exp()
