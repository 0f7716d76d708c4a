"""What a measurement cannot tell, a line each."""

from collections.abc import Sequence

import numpy as np

from tg4mm.core.lines import FEWEST
from tg4mm.fit.motion.mode_selection import frequency_notes
from tg4mm.show.measure.linearity import lacking
from tg4mm.show.measure.orbit import main_is_above
from tg4mm.show.measure.scene import Prepared
from tg4mm.show.measure.sensor_result import SensorResult

_HIDDEN = 0.5  # of a motion: what the scene at rest hides of it, from here on it is said
_OTHER = 0.5  # of the largest changes: what is no motion of the region, from here on its numbers are none
_LACKING = 0.05  # of the largest motion: what the answer lacks of it, from here on it is said


def _of_region(result: SensorResult) -> list[str]:
    """What a region of a flat capture shows beside its motion."""
    if (motion := result.motion) is None:
        return []
    out = []
    if motion.hidden.any():
        out.append(
            f"{result.name}: something passes in {int(motion.hidden.sum())} of {len(motion.hidden)} frames; the motion "
            "is interpolated there"
        )
    size = float(np.linalg.norm(motion.whole - np.median(motion.whole, 0), axis=1).max())
    if (other := motion.other_share) > _OTHER:
        out.append(
            f"{result.name}: {100 * other:.0f} % of its largest changes are not explained by a motion of "
            f"{size:.2g} px: something passes, light changes, or parts move differently, and its numbers may show it"
        )
    elif size > 1 and not motion.is_iterated:
        out.append(
            f"{result.name} moves by up to {size:.2g} px, and was measured in one step: it may move by more; choose a "
            "smaller region"
        )
    return out


def limits_of(scene: Prepared, results: Sequence[SensorResult]) -> tuple[str, ...]:
    """Return the limits of the capture, then those of the sensors."""
    out = list(scene.notes)
    if not scene.capture.kind.sees_depth:
        where = (
            "in pixels of its picture" if scene.scale is None else "of the plane that its scale was marked on"
        )
        out.append(f"a flat capture shows only motion across the line of sight, {where}")
    elif not scene.is_moving and len(scene.views) == len(scene.clocks) == 1:
        out.append(
            "one camera hardly shows motion along its line of sight: there waveforms have a much larger ±"
        )
    if len(scene.clocks) > 1:
        out.append(
            "the cameras' clocks are independent: peaks combine all cameras, assuming a steady vibration; a "
            "waveform is that of one camera, which hardly shows motion along its line of sight"
        )
    if scene.is_moving:
        out.append(
            "slow motion, and common motion of the scene: both are removed as motion of the moving camera"
        )
    if hz := scene.fit.undetermined_hz:
        named = ", ".join(f"{f:.4g}" for f in hz)
        out.append(
            f"which of two parts that move against each other at {named} Hz stands still: every ± is at least as large "
            "as the motion"
        )
    if len(scene.means) and not scene.fit.uncertainty:
        out.append(
            "the run has no uncertainty of its Gaussians: every ± covers noise only, and shapes include noise"
        )
    for result in results:
        out += _of_region(result)
        if (found := lacking(scene, result)) is not None:
            size, share, deviation, other = found
            if other > _OTHER:
                out.append(
                    f"{result.name}: {100 * other:.0f} % of its largest changes are not explained by a motion of "
                    f"{size:.2g} px: something passes, or light changes, and its numbers may show it"
                )
            elif share > max(_LACKING, 2 * deviation):
                out.append(
                    f"{result.name} moves by up to {size:.2g} px, beyond the linear range of its picture: "
                    f"the largest motions are underestimated by {100 * share:.0f} %"
                )
        for series in result.all_series:
            is_hidden = (series.false_share > _HIDDEN) & series.is_resolved
            if hidden := [axis for axis, hides in zip(series.labels, is_hidden, strict=True) if hides]:
                where = f" in {series.clock}" if series.clock else ""
                out.append(
                    f"{result.name}: motion along {', '.join(hidden)}{where} is hardly visible: most of what the "
                    "scene at rest would show of it is not in the pictures"
                )
        longest = max(len(s.times_s) for s in result.all_series)
        if longest < FEWEST:
            out.append(f"{result.name}: {longest} frames are too few for a spectrum, {FEWEST} are needed")
        elif not result.spectrum.peaks:
            out.append(f"{result.name}: nothing stands out of the noise floor")
    sure = {
        round(peak.frequency_hz, 3)
        for r in results
        for peak, orbit in zip(r.spectrum.peaks, r.orbits, strict=True)
        if main_is_above(peak, orbit)
    }
    return tuple(out + frequency_notes(sorted(sure), scene.observations))
