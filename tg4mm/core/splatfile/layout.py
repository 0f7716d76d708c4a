"""How a splat file is laid out: property names, the header line `comment tg4mm {json}`, activations."""

from __future__ import annotations

import numpy as np

FORMAT_VERSION = 1
MARK = "comment tg4mm "
POSITION = ("x", "y", "z")
NORMAL = ("nx", "ny", "nz")  # zeros, there because viewers expect them
F_DC = ("f_dc_0", "f_dc_1", "f_dc_2")
OPACITY = ("opacity",)
SCALE = ("scale_0", "scale_1", "scale_2")
ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")

# exp and the sigmoid never give exactly 0 or 1, so these ends are written as the nearest that survives.
SMALLEST_SCALE = 1e-12  # scene units; written for anything smaller
OPACITY_MARGIN = 2.0**-24  # opacities are written between this and 1 minus this, the float32 next to 1


def f_rest(count: int) -> tuple[str, ...]:
    """Names of `count` further SH coefficients: channel-major, all of red, then green, then blue."""
    return tuple(f"f_rest_{i}" for i in range(count))


def f_dc(rgb: np.ndarray) -> np.ndarray:
    """Colour in 0..1 → coefficient of the constant harmonic."""
    return (rgb - 0.5) / 0.28209479177387814


def mode(k: int) -> tuple[str, ...]:
    """The twelve properties of mode k: displacement re, im, then rotation vector re, im; x, y, z each."""
    parts = ("re_", "im_", "re_r", "im_r")
    return tuple(f"mode_{k}_{part}{axis}" for part in parts for axis in "xyz")


def deviation(k: int) -> str:
    """The property of mode k that holds the standard deviation of its amplitude; a file has all of them or none."""
    return f"mode_{k}_sd"


def log_scale(scales: np.ndarray) -> np.ndarray:
    """Linear scale → log scale."""
    return np.log(np.maximum(scales.astype(np.float64), SMALLEST_SCALE))


def logit(opacities: np.ndarray) -> np.ndarray:
    """Opacity in 0..1 → logit."""
    p = np.clip(opacities.astype(np.float64), OPACITY_MARGIN, 1 - OPACITY_MARGIN)
    return np.log(p) - np.log1p(-p)


def sigmoid(logits: np.ndarray) -> np.ndarray:
    """Logit → opacity in 0..1, without overflow for large negative logits."""
    e = np.exp(-np.abs(logits.astype(np.float64)))  # of ±infinity 0
    return np.where(logits >= 0, 1 / (1 + e), e / (1 + e))
