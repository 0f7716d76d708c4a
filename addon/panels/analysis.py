"""Numbers of a splat object, read from its points: amplitude in the band, and what a legend says."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tg4mm.core.colour import STILL_BELOW
from tg4mm.core.errors import Tg4mmError

from .. import compat, names
from ..nodes import scene, spectrum
from ..nodes.points import gaussians, shown_size, values
from ..units import Unit
from . import plots, view_colours


def active_modes(obj: Any) -> list[int]:
    """Numbers of the modes that are shown and inside the band."""
    modifier = scene.splat_modifier(obj)
    freqs = [float(f) for f in obj[names.FREQUENCIES]]
    low, high = (compat.get_input(modifier, name) for name in (names.LOW, names.HIGH))
    shown = names.toggles(freqs)
    slack = [1e-6 * max(1.0, f) for f in freqs]  # as in the node tree
    inside = [low < f + s and high > f - s for f, s in zip(freqs, slack, strict=True)]
    return [k for k, name in enumerate(shown) if inside[k] and compat.get_input(modifier, name)]


def band_amplitude(obj: Any) -> np.ndarray:
    """[N] scene units: √Σ a_k² over the active modes, not magnified; what Colour By: Amplitude shows.

    Raises Tg4mmError if a person has removed the attributes that hold it.
    """
    every = [values(obj.data, names.amplitude(k)).astype(np.float64) for k in active_modes(obj)]
    return np.sqrt(sum((a**2 for a in every), np.zeros(gaussians(obj.data).sum())))


def fit_colour_range(obj: Any) -> float:
    """Set the colour range to the largest amplitude in the band, scene units, and return it.

    Raises Tg4mmError where nothing moves in the band.
    """
    largest = float(band_amplitude(obj).max(initial=0.0))
    if largest == 0.0:
        raise Tg4mmError("Nothing moves in the band")
    compat.set_input(scene.splat_modifier(obj), names.COLOUR_RANGE, largest)
    return largest


def metres_per_unit(obj: Any) -> float | None:
    """Metres per unit of the world, by the file and by how the object was scaled; None where the file does not say."""
    metres = obj.get(names.UNIT_SCALE)
    if metres is None or not (size := shown_size(obj)):
        return None
    return float(metres) / size


def units_differ(obj: Any, scene_: Any) -> str:
    """What to say where Blender's own lengths are in other metres than the file's; "" where they agree."""
    metres, settings = metres_per_unit(obj), scene_.unit_settings
    if (
        metres is None
        or settings.system == "NONE"
        or math.isclose(metres, settings.scale_length, rel_tol=1e-3)
    ):
        return ""
    return f"A unit is {metres:.4g} m here, {settings.scale_length:.4g} m in Blender"


def legend_picture(obj: Any, unit: Unit, settings: Any) -> tuple[Any, ...] | None:
    """The function of `plots` that draws the legend, and its arguments; None where there is no legend.

    `settings`: the scene's, whose view transform the colours go through as the object's do.
    """
    modifier = scene.splat_modifier(obj)
    if modifier is None or not compat.has_input(modifier, names.COLOUR_BY):
        return None
    kind = compat.get_input(modifier, names.COLOUR_BY)
    if kind == names.FILE_COLOUR:
        return None
    highest = compat.get_number(modifier, names.COLOUR_RANGE)
    encoded = compat.has_input(modifier, names.BLEND) and bool(compat.get_input(modifier, names.BLEND))
    if kind == names.PHASE_COLOUR:
        return plots.phase_legend, STILL_BELOW * highest, unit, view_colours.phase(settings, encoded)
    return plots.amplitude_legend, highest, unit, view_colours.amplitude(settings, encoded)


def band(obj: Any) -> tuple[float, float]:
    """Low and high of the band, Hz."""
    low, high = (compat.get_number(scene.splat_modifier(obj), name) for name in (names.LOW, names.HIGH))
    return low, high


def set_band(obj: Any, low: float, high: float) -> None:
    """Set the band, Hz."""
    modifier = scene.splat_modifier(obj)
    compat.set_input(modifier, names.LOW, low)
    compat.set_input(modifier, names.HIGH, high)


def mode_strengths(obj: Any, measure: str) -> list[float]:
    """Amplitude of each mode, scene units: the largest of all Gaussians (PEAK) or their rms (RMS)."""
    largest = [float(a) for a in obj[names.MODE_AMPLITUDES]]
    return largest if measure == "PEAK" else [float(a) for a in obj.get(names.MODE_RMS, largest)]


def peaks(obj: Any) -> list[float]:
    """Frequencies, Hz, of the peaks of an object's spectrum."""
    freqs = [float(f) for f in obj[names.FREQUENCIES]]
    bin_hz = float(obj[names.FPS]) / max(int(obj[names.TIMESTEPS]), 1)
    return [freqs[k] for k in spectrum.peaks(freqs, mode_strengths(obj, "RMS"), bin_hz)]
