"""Colours between linear light and display-referred sRGB, alpha between premultiplied and straight."""

from __future__ import annotations

import numpy as np


def to_display(linear: np.ndarray) -> np.ndarray:
    """Linear light to sRGB (IEC 61966-2-1), clipped to 0 … 1, of any shape; float in, the same float out."""
    x = np.clip(linear, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055).astype(x.dtype)


def to_linear(display: np.ndarray) -> np.ndarray:
    """sRGB in 0 … 1 to linear light, of any shape; the inverse of `to_display`."""
    x = np.clip(display, 0.0, 1.0)
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4).astype(x.dtype)


def to_integers(values: np.ndarray, bits: int) -> np.ndarray:
    """Values in 0 … 1, clipped, to the nearest of 0 … 2^bits − 1: uint8 for 8 bits, uint16 for 16."""
    if bits not in (8, 16):
        raise ValueError(f"{bits} bits; a picture has 8 or 16")
    scaled = np.clip(values, 0.0, 1.0) * (2**bits - 1)
    return np.floor(scaled + 0.5).astype(np.uint8 if bits == 8 else np.uint16)


def straight(premultiplied: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[H, W, 4] premultiplied to colours [H, W, 3], 0 where alpha is 0, and alpha [H, W] in 0 … 1."""
    alpha = np.clip(premultiplied[..., 3], 0.0, 1.0)
    divisor = np.where(alpha > 0, alpha, 1)[..., None]
    return np.where(alpha[..., None] > 0, premultiplied[..., :3] / divisor, 0), alpha


def over_white(premultiplied: np.ndarray) -> np.ndarray:
    """[H, W, 4] linear and premultiplied, over white: [H, W, 3] linear.

    The sum is taken on display-referred values (docs/conventions.md, "Images"), so the picture is the one that
    a reader makes of the transparent file, and edges lie in the same place. Opaque pixels stay as they are, those
    brighter than white too.
    """
    colour, alpha = straight(premultiplied)
    weight = alpha[..., None]
    return np.where(weight == 1, colour, to_linear(to_display(colour) * weight + (1 - weight)))
