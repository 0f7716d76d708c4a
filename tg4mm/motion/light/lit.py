"""Gaussians in changed light."""

from __future__ import annotations

import math

import torch
from torch import Tensor

# Of a Gaussian's change of colour, display-referred. What is seen of light is linear as far as the capture shows it;
# magnified it saturates in truth (gloss that has moved on does not get darker), so it is drawn in: docs/decisions.md
LIMIT = 0.1
_MEAN = 1 / (2 * math.sqrt(math.pi))  # the first spherical harmonic, by which a coefficient becomes a colour


def lit(sh: Tensor, shapes: Tensor, coefficients: Tensor) -> Tensor:
    """Spherical harmonics [N, K', 3] with Σ_r coefficients[r] shapes[r] added to the first K ≤ K' coefficients.

    shapes [R, N, K, 3], coefficients [R]. The change of one Gaussian, root of the sum over channels and coefficients
    and measured in colours, is s = LIMIT · tanh(change / LIMIT), so that it never comes to more than `LIMIT`.
    """
    change = torch.tensordot(coefficients, shapes, dims=1)
    size = torch.linalg.vector_norm(change.flatten(1), dim=1) * (_MEAN / LIMIT)
    change = change * (torch.tanh(size) / size.clamp_min(1e-6))[:, None, None]
    out = sh.clone()
    out[:, : change.shape[1]] += change
    return out
