"""Leaves, bark and soil."""

from __future__ import annotations

import numpy as np

from ..scene import Rgb
from ..textures import noise


def blade(
    height: int, width: int, colour: Rgb, veins: Rgb, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """One face of a leaf: u from base to tip, v across, midrib in the middle: (picture [H, W, 3], relief [H, W])."""
    u = ((np.arange(width) + 0.5) / width)[None]
    across = ((np.arange(height) + 0.5) / height * 2.0 - 1.0)[:, None]
    c = np.abs(across)
    midrib = np.exp(-((c / (0.075 * (1.15 - u))) ** 2))
    along = (u - 0.34 * c) * 13.0 + 0.25 * np.sign(across)
    distance = np.abs(along % 1.0 - 0.5)
    lateral = np.exp(-((distance / 0.085) ** 2)) * (1.0 - 0.75 * c) * (u > 0.03)
    fine = np.exp(-((np.abs((along * 4.0) % 1.0 - 0.5) / 0.2) ** 2)) * 0.25 * (1.0 - c)
    web = np.clip(midrib + 0.75 * lateral + fine, 0.0, 1.0)[..., None]
    mottle = np.tanh(0.7 * noise(height, width, (5, 8), rng) + 0.5 * noise(height, width, (16, 30), rng))
    gain = (1.0 + 0.22 * mottle) * (0.86 + 0.3 * distance * (1.0 - 0.5 * c))
    margin = np.clip((c - 0.80) / 0.14, 0.0, 1.0)[..., None] * np.ones((1, width, 1))
    image = np.array(colour) * gain[..., None]
    image = image * (1.0 - 0.55 * margin) + 0.55 * margin * np.array(veins)
    image = image * (1.0 - 0.8 * web) + 0.8 * web * np.array(veins)
    tip = np.clip((u - 0.93) / 0.07, 0.0, 1.0)[..., None]  # often a little dry
    image = image * (1.0 - 0.5 * tip) + 0.5 * tip * np.array([0.5, 0.4, 0.16])
    return np.clip(image, 0.0, 1.0), np.clip(0.75 - 0.6 * web[..., 0] + 0.04 * mottle, 0.0, 1.0)


def bark(height: int, width: int, colour: Rgb, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Grey bark; the axis runs along u: long fissures, cross rings, pale lenticels: (picture, relief)."""
    fissures = np.tanh(noise(height, width, (12, 9), rng) + 0.5 * noise(height, width, (26, 20), rng))
    rings = np.tanh(1.4 * noise(height, width, (3, 40), rng))
    spots = np.clip(noise(height, width, (22, 52), rng) - 1.35, 0.0, 0.8)
    moss = np.clip(noise(height, width, (4, 4), rng) - 0.5, 0.0, 1.0)[..., None]
    gain = 1.0 + 0.3 * fissures + 0.16 * rings
    image = np.array(colour) * gain[..., None] + spots[..., None] * np.array([0.35, 0.31, 0.25])
    image = image * (1.0 - 0.35 * moss) + 0.35 * moss * np.array([0.30, 0.33, 0.19])
    return np.clip(image, 0.0, 1.0), np.clip(0.5 + 0.28 * fissures + 0.15 * rings, 0.0, 1.0)


def soil(size: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Potting soil with bark chips and white grains: (picture [H, W, 3], relief [H, W])."""
    crumbs = np.tanh(noise(size, size, (26, 26), rng) + 0.7 * noise(size, size, (60, 60), rng))
    chips = np.clip(2.0 * noise(size, size, (18, 34), rng) - 2.4, 0.0, 1.0)[..., None]
    grains = np.clip(3.0 * noise(size, size, (64, 64), rng) - 6.6, 0.0, 1.0)[..., None]
    image = np.array([0.20, 0.145, 0.10]) * (1.0 + 0.5 * crumbs[..., None])
    image = image * (1.0 - chips) + chips * np.array([0.42, 0.26, 0.15])
    image = image * (1.0 - grains) + grains * np.array([0.8, 0.78, 0.72])
    return np.clip(image, 0.0, 1.0), np.clip(0.5 + 0.25 * crumbs + 0.2 * chips[..., 0], 0.0, 1.0)
