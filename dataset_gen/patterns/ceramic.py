"""Pottery: glaze that ran and broke at the edges, and bare fired clay."""

from __future__ import annotations

import numpy as np

from ..scene import Rgb
from ..textures import noise


def running_glaze(
    height: int, width: int, body: Rgb, over: Rgb, edge: float, reach: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """A second glaze poured over the upper part: (picture [H, W, 3], mask of the second glaze [H, W]).

    It starts above v = `edge` and runs down in tongues as long as `reach`.
    """
    v = ((np.arange(height) + 0.5) / height)[:, None]
    tongues, small = (noise(8, width, (1, waves), rng)[:1] for waves in (13, 34))
    line = edge - reach * (0.5 + 0.36 * np.tanh(tongues) + 0.08 * np.tanh(small))
    mask = np.clip((v - line) / 0.012, 0.0, 1.0)
    speck = np.clip(2.5 * noise(height, width, (60, 150), rng) - 4.2, 0.0, 1.0)
    cloud = np.tanh(0.7 * noise(height, width, (6, 14), rng) + 0.4 * noise(height, width, (24, 60), rng))
    under = np.array(body) * (1.0 + 0.22 * cloud)[..., None]
    upper = np.array(over) * (1.0 + 0.16 * cloud)[..., None]
    image = under * (1.0 - mask[..., None]) + upper * mask[..., None]
    rim = np.exp(-(((v - line - 0.004) / 0.012) ** 2))[..., None]  # the bead along the lower edge
    image = image * (1.0 - 0.45 * rim) + 0.45 * rim * (0.5 * np.array(over) + np.array([0.12, 0.1, 0.05]))
    image = image * (1.0 - 0.7 * speck[..., None]) + 0.7 * speck[..., None] * np.array([0.09, 0.07, 0.05])
    return np.clip(image, 0.0, 1.0), mask


def terracotta(height: int, width: int, rng: np.random.Generator) -> np.ndarray:
    """Fired clay with turning lines, lime bloom and stains."""
    rings = noise(height, width, (40, 1), rng)
    grain = noise(height, width, (60, 90), rng)
    bloom = np.clip(noise(height, width, (5, 10), rng) - 0.3, 0.0, 1.0)[..., None]
    image = np.array([0.62, 0.33, 0.21]) * (1.0 + 0.07 * rings + 0.12 * np.tanh(grain))[..., None]
    return np.clip(image * (1.0 - 0.3 * bloom) + 0.3 * bloom * np.array([0.82, 0.74, 0.66]), 0.0, 1.0)
