"""Colours in numbers: what the file's mean in linear light, and the two colour maps."""

from __future__ import annotations

import numpy as np

from ..core.colour import STILL, amount_colours, phase_colours

C0 = 0.28209479177387814  # Y_00, the constant spherical harmonic: 1 / (2 √π)
STEPS = 24  # of a colour map: a Color Ramp has at most 32 colours


def linear(srgb: np.ndarray) -> np.ndarray:
    """Display-referred sRGB in 0..1, any shape, to linear light."""
    srgb = np.asarray(srgb, np.float64)
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def display(rgb: np.ndarray) -> np.ndarray:
    """Linear light in 0..1, any shape, to display-referred sRGB."""
    rgb = np.asarray(rgb, np.float64)
    return np.where(rgb <= 0.0031308, rgb * 12.92, 1.055 * np.maximum(rgb, 0.0) ** (1 / 2.4) - 0.055)


def rest_colours(sh: np.ndarray) -> np.ndarray:
    """[N, 4] linear RGBA of sh [N, K, 3]: the part that does not depend on the view.

    Spherical harmonics of [3DGS] give display-referred sRGB, 0.5 + C0·sh_0; emission needs linear light.
    """
    rgb = linear(np.clip(0.5 + C0 * sh[:, 0].astype(np.float64), 0.0, 1.0))
    return np.concatenate([rgb, np.ones((len(sh), 1))], axis=1)


def amplitude_map() -> np.ndarray:
    """[STEPS + 1, 3] linear RGB of equal steps from 0 to the largest amplitude: the report's map for amounts."""
    return linear(amount_colours(np.linspace(0.0, 1.0, STEPS + 1)))


def phase_map() -> np.ndarray:
    """[STEPS + 1, 3] linear RGB of equal steps from 0 to one turn, first and last alike: the report's for phases."""
    return linear(phase_colours(2 * np.pi * np.arange(STEPS + 1) / STEPS))


def phase_and_still() -> np.ndarray:
    """[STEPS + 2, 3] the map for phases, then the grey of what hardly moves."""
    return np.vstack([phase_map(), np.full((1, 3), still())])


def still() -> float:
    """Linear grey of what moves too little to have a phase."""
    return float(linear(np.array(STILL)))
