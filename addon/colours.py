"""Colours in numbers: what the file's mean in linear light, and the two colour maps."""

from __future__ import annotations

import numpy as np

C0 = 0.28209479177387814  # Y_00, the constant spherical harmonic: 1 / (2 √π)
# viridis (Smith, van der Walt, Firing; CC0) at 0, 0.1 … 1: equal steps look equal, and print in grey.
_VIRIDIS = "440154 482475 414487 355f8d 2a788e 21918c 22a884 44bf70 7ad151 bddf26 fde725"
STILL = 0.09  # linear grey of what hardly moves: it has no phase to show
STILL_BELOW = 0.05  # of the colour range
# OKLab (Ottosson 2020) to linear sRGB: lms' from (L, a, b), then rgb from its cubes.
_FROM_OKLAB = np.array(
    [
        [1.0, 0.3963377774, 0.2158037573],
        [1.0, -0.1055613458, -0.0638541728],
        [1.0, -0.0894841775, -1.291485548],
    ]
)
_FROM_LMS = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.707614701],
    ]
)


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
    """[11, 3] linear RGB of equal steps from 0 to the largest amplitude: viridis."""
    rows = [[int(code[i : i + 2], 16) / 255 for i in (0, 2, 4)] for code in _VIRIDIS.split()]
    return linear(np.array(rows))


def phase_map(steps: int = 24) -> np.ndarray:
    """[steps + 1, 3] linear RGB of equal steps from 0 to one turn, first and last alike.

    A circle of one lightness and one chroma in OKLab, so that no phase stands out.
    """
    turn = 2 * np.pi * np.arange(steps + 1) / steps
    lab = np.stack([np.full_like(turn, 0.74), 0.122 * np.cos(turn), 0.122 * np.sin(turn)], axis=1)
    return np.clip((lab @ _FROM_OKLAB.T) ** 3 @ _FROM_LMS.T, 0.0, 1.0)
