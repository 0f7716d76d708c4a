"""sRGB and linear light; colour maps of even lightness by OKLab, for amounts and, closing on itself, for phases.

The report, the viewer and the extension for Blender all take theirs from here. Needs numpy alone.

OKLab: B. Ottosson, "A perceptual color space for image processing" (2020).
"""

import numpy as np

_LMS_FROM_LAB = np.array(
    [
        [1.0, 0.3963377774, 0.2158037573],
        [1.0, -0.1055613458, -0.0638541728],
        [1.0, -0.0894841775, -1.2914855480],
    ]
)
_RGB_FROM_LMS = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)
# Stops of the map for amounts: lightness, chroma, hue in degrees. Dark is little, light is much.
_STOPS = np.array(
    [
        [0.22, 0.06, 275.0],
        [0.38, 0.13, 300.0],
        [0.54, 0.17, 350.0],
        [0.70, 0.16, 40.0 + 360],
        [0.84, 0.14, 75.0 + 360],
        [0.97, 0.08, 105.0 + 360],
    ]
)
STILL = 0.55  # sRGB grey of what moves too little to have a phase
# of the scale's top: grey below, a phase's colour above, a mixture between
STILL_BELOW, MOVES_ABOVE = (0.1, 0.2)


def to_display(linear: np.ndarray) -> np.ndarray:
    """Linear light to sRGB (IEC 61966-2-1), clipped to 0 … 1, of any shape; float in, the same float out."""
    x = np.clip(linear, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055).astype(x.dtype)


def to_linear(display: np.ndarray) -> np.ndarray:
    """sRGB in 0 … 1 to linear light, of any shape; the inverse of `to_display`."""
    x = np.clip(display, 0.0, 1.0)
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4).astype(x.dtype)


def srgb_of_oklch(lightness: np.ndarray, chroma: np.ndarray, hue_deg: np.ndarray) -> np.ndarray:
    """Display-referred sRGB [..., 3] in 0..1 of OKLCH coordinates, clipped to the gamut."""
    hue = np.radians(hue_deg)
    lab = np.stack(np.broadcast_arrays(lightness, chroma * np.cos(hue), chroma * np.sin(hue)), axis=-1)
    return to_display(((lab @ _LMS_FROM_LAB.T) ** 3) @ _RGB_FROM_LMS.T)


def amount_colours(values: np.ndarray) -> np.ndarray:
    """sRGB [..., 3] in 0..1 for amounts in 0..1 (clipped); lightness rises with the amount."""
    position = np.clip(values, 0.0, 1.0) * (len(_STOPS) - 1)
    lightness, chroma, hue = (np.interp(position, np.arange(len(_STOPS)), column) for column in _STOPS.T)
    return srgb_of_oklch(lightness, chroma, hue)


def phase_colours(phase: np.ndarray) -> np.ndarray:
    """sRGB [..., 3] in 0..1 for phases in radians; equal lightness all around, −π and π meet."""
    return srgb_of_oklch(
        np.full(np.shape(phase), 0.72), np.full(np.shape(phase), 0.125), np.degrees(phase) + 250.0
    )


def phase_share(part: np.ndarray) -> np.ndarray:
    """Return the saturation (0..1) of a phase colour for an amplitude of `part` times the scale's maximum."""
    return np.clip((part - STILL_BELOW) / (MOVES_ABOVE - STILL_BELOW), 0.0, 1.0)


def hex_colour(rgb: np.ndarray) -> str:
    """#rrggbb of one sRGB colour [3] in 0..1."""
    return "#" + "".join(f"{round(float(c) * 255):02x}" for c in rgb)
