"""Rope and cloth: laid strands, canvas with seams and wrinkles, stained."""

from __future__ import annotations

import numpy as np

from ..scene import Rgb
from ..textures import diagonal, noise


def laid(
    height: int, width: int, colour: Rgb, rng: np.random.Generator, turns: float = 6.0
) -> tuple[np.ndarray, np.ndarray]:
    """Three-strand rope: (picture [H, W, 3], height [H, W]); tiles along v."""
    strands = np.sqrt(np.abs(2.0 * diagonal(height, width, turns, 1) - 1.0))
    spots = np.tanh(noise(height, width, (8, 3), rng))
    gain = (0.45 + 0.6 * strands) * (1.0 + 0.25 * spots)
    return np.clip(np.array(colour) * gain[..., None], 0.0, 1.0), strands


def canvas(
    height: int, width: int, colour: Rgb, rng: np.random.Generator, seams: int, wrinkles: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Old sailcloth, seams along u every 1/`seams` of v: (picture [H, W, 3], height of the wrinkles [H, W])."""
    folds = noise(height, width, wrinkles, rng)
    ridges = 1.0 - np.abs(np.tanh(1.2 * folds))
    weave = rng.standard_normal((height, width))
    stains = np.tanh(noise(height, width, (5, 3), rng))
    v = (np.arange(height) + 0.5) / height * seams
    near = np.abs(v % 1.0 - 0.5)
    seam = ((near < 0.05) | (np.abs(near - 0.1) < 0.012)).astype(float)[:, None]
    gain = (1.0 + 0.10 * stains + 0.035 * weave) * (0.74 + 0.3 * ridges) * (1.0 - 0.32 * seam)
    tint = np.array([1.0, 0.985, 0.95]) ** (1.0 + stains[..., None])
    return np.clip(np.array(colour) * gain[..., None] * tint, 0.0, 1.0), np.clip(
        0.8 * ridges + 0.2 * seam, 0, 1
    )
