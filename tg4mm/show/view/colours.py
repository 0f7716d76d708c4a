"""Colours of the Gaussians: as filmed, or by amplitude, phase and uncertainty, in the report's colour maps."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from markupsafe import Markup

from tg4mm.core.colour import STILL, amount_colours, phase_colours, phase_share
from tg4mm.core.pages.svg import colour_bar, number, phase_bar
from tg4mm.core.phasors import main_direction, peak_displacement, scale_top
from tg4mm.show.view.scene import Scene

Band = tuple[float, float] | None


class Colour(StrEnum):
    """What the colours show."""

    picture = "as filmed"
    amplitude = "amplitude"
    phase = "phase"
    uncertainty = "uncertainty"


def choices(scene: Scene) -> tuple[Colour, ...]:
    """The colours that this scene has data for."""
    if scene.motion is None or not len(scene.frequencies):
        return (Colour.picture,)
    return tuple(c for c in Colour if c is not Colour.uncertainty or scene.deviation is not None)


def gaussian_colours(scene: Scene, colour: Colour, band: Band) -> np.ndarray | None:
    """[N, 3] sRGB in 0..1; None for the colours as filmed, and where no frequency is in the band.

    Amplitude (peak displacement) and phase (of the motion along its main direction, at timestep 0) are those of the
    frequency in the band that moves most; phases fade to grey where there is little motion. Uncertainty is the standard
    deviation of the displacement, of all frequencies together.
    """
    if colour is Colour.uncertainty and scene.deviation is not None:
        return amount_colours(scene.deviation / max(scale_top(scene.deviation, scene.weights), 1e-30))
    k = scene.strongest(band)
    if colour is Colour.picture or k is None or scene.motion is None:
        return None
    phasors = scene.motion.displacement[k]
    amplitude = peak_displacement(phasors)
    top = scale_top(amplitude, scene.weights)
    if colour is Colour.phase:
        angle = np.angle(phasors @ main_direction(phasors, scene.weights))
        share = phase_share(amplitude / max(top, 1e-30))[:, None]
        return share * phase_colours(angle) + (1 - share) * STILL
    return amount_colours(amplitude / max(top, 1e-30))


def legend(scene: Scene, colour: Colour, band: Band) -> Markup:
    """The scale of the colours, as a drawing under a line that names what is shown; empty for `as filmed`."""
    if colour is Colour.picture or scene.motion is None:
        return Markup()
    if colour is Colour.uncertainty and scene.deviation is not None:
        top = scale_top(scene.deviation, scene.weights) * scene.per_unit
        words = Markup("<p>Standard deviation of the displacement, rms over time.</p>{}")
        return words.format(colour_bar(top, scene.unit, "standard deviation"))
    k = scene.strongest(band)
    if k is None:
        return Markup("<p>No frequency lies in the band: colours as filmed.</p>")
    at = f"{number(float(scene.motion.freqs_hz[k]))} Hz"
    if colour is Colour.phase:
        return Markup("<p>Motion at {}; grey: below a tenth of the largest.</p>{}").format(at, phase_bar())
    top = scale_top(peak_displacement(scene.motion.displacement[k]), scene.weights) * scene.per_unit
    bar = colour_bar(top, scene.unit, "peak displacement")
    return Markup("<p>Motion at {}, as captured.</p>{}").format(at, bar)
