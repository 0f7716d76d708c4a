"""Bands of the viewer from its slider and peaks, and a colour for each Gaussian's motion."""

from collections.abc import Sequence
from enum import StrEnum

import numpy as np
from markupsafe import Markup

from tg4mm.core.colour import STILL, amount_colours, phase_colours, phase_share
from tg4mm.core.digits import number
from tg4mm.core.magnification import Magnification
from tg4mm.core.pages.charts import colour_bar, phase_bar
from tg4mm.core.phasors import main_direction, peak_displacement, scale_top
from tg4mm.show.view.scene import RunScene

Band = tuple[float, float] | None
ALL = "all"  # the button for all frequencies
_BUTTONS = 8  # peaks that get a button
_FAINT = 0.05  # of the largest peak; lower ones get no button


class Colour(StrEnum):
    """The quantity shown by the colours."""

    picture = "as filmed"
    amplitude = "amplitude"
    phase = "phase"
    uncertainty = "uncertainty"


def choices(scene: RunScene) -> tuple[Colour, ...]:
    """Return the colours for which the scene has data."""
    if scene.motion is None or not len(scene.frequencies):
        return (Colour.picture,)
    return tuple(c for c in Colour if c is not Colour.uncertainty or scene.deviation is not None)


def gaussian_colours(scene: RunScene, colour: Colour, magnified: Magnification) -> np.ndarray | None:
    """Return sRGB [N, 3] in 0..1; None for the colours as filmed, and without a frequency in the band.

    Amplitude (peak displacement) and phase (of the motion along its main direction, at timestep 0) are those of the
    band's strongest frequency; phases of little motion fade to grey. Uncertainty is the standard deviation of the
    displacement, for all frequencies together.
    """
    if colour is Colour.uncertainty and scene.deviation is not None:
        return amount_colours(scene.deviation / max(scale_top(scene.deviation, scene.weights), 1e-30))
    k = scene.strongest(magnified)
    if colour is Colour.picture or k is None or scene.motion is None:
        return None
    phasors = scene.motion.displacement_of(k)
    amplitude = peak_displacement(phasors)
    top = scale_top(amplitude, scene.weights)
    if colour is Colour.phase:
        angle = np.angle(phasors @ main_direction(phasors, scene.weights))
        share = phase_share(amplitude / max(top, 1e-30))[:, None]
        return share * phase_colours(angle) + (1 - share) * STILL
    return amount_colours(amplitude / max(top, 1e-30))


def legend(scene: RunScene, colour: Colour, magnified: Magnification) -> Markup:
    """Return the colour scale under a line that names its quantity; empty for `as filmed`."""
    if colour is Colour.picture or scene.motion is None:
        return Markup()
    if colour is Colour.uncertainty and scene.deviation is not None:
        top = scale_top(scene.deviation, scene.weights) * scene.per_unit
        words = Markup("<p>Standard deviation of the displacement, rms over time.</p>{}")
        return words.format(colour_bar(top, scene.unit, "standard deviation"))
    k = scene.strongest(magnified)
    if k is None:
        return Markup("<p>No frequency lies in the band: colours as filmed.</p>")
    at = f"{number(float(scene.motion.freqs_hz[k]))} Hz"
    if colour is Colour.phase:
        return Markup("<p>Motion at {}; grey: below a tenth of the largest.</p>{}").format(at, phase_bar())
    top = scale_top(peak_displacement(scene.motion.displacement_of(k)), scene.weights) * scene.per_unit
    bar = colour_bar(top, scene.unit, "peak displacement")
    return Markup("<p>Motion at {}, as captured.</p>{}").format(at, bar)


def band_of_slider(low: float, high: float, nyquist: float) -> Band:
    """Return the band between two slider positions, Hz; None, all frequencies, for the complete range."""
    low, high = min(low, high), max(low, high)
    return None if low <= 0 and high >= nyquist * (1 - 1e-9) else (low, high)


def band_around(frequency: float, frequencies: np.ndarray, nyquist: float) -> tuple[float, float]:
    """Return a band around one of `frequencies` (Hz) without any other, at most a tenth of it to either side."""
    others = np.abs(frequencies - frequency)
    others = others[others > 1e-9]
    reach = min(0.1 * frequency, 0.5 * float(others.min()) if len(others) else np.inf)
    return max(frequency - reach, 0.0), min(frequency + reach, nyquist)


def main_peaks(frequencies: np.ndarray, peaks: np.ndarray, duration: float) -> np.ndarray:
    """Return the strongest frequencies, which get a button, ascending; none below 5 % of the largest peak.

    Cycles longer than the capture's `duration` in seconds are drift, and count only if there are no others.
    """
    cyclic = frequencies * duration > 1 - 1e-9
    peaks = np.where(cyclic, peaks, 0.0) if cyclic.any() else peaks
    order = np.argsort(-peaks, kind="stable")[:_BUTTONS]
    return np.sort(frequencies[[k for k in order if peaks[k] >= _FAINT * peaks.max()]])


def peak_labels(frequencies: Sequence[float] | np.ndarray) -> tuple[str, ...]:
    """Return labels such as `3.4 Hz` with enough digits to distinguish them."""
    for digits in (3, 4, 5, 6):
        labels = tuple(f"{number(float(f), digits)} Hz" for f in frequencies)
        if len(set(labels)) == len(labels):
            return labels
    return tuple(f"{float(f)!r} Hz" for f in frequencies)


def band_words(band: Band, frequencies: np.ndarray) -> str:
    """Describe the band's contents in one line."""
    if not len(frequencies):
        return "This run has no frequencies to magnify."
    count = len(frequencies)
    if band is None:
        return f"All frequencies ({count})."
    inside = int(((frequencies >= band[0]) & (frequencies <= band[1])).sum())
    between = f"{number(band[0])} to {number(band[1])} Hz"
    if not inside:
        return f"{between}: none of the {count} frequencies; nothing is magnified."
    return f"{between}: {inside} of {count} frequencies."
