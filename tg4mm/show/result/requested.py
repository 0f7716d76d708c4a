"""Checks of a request against a run: `--band auto`, bands without motion, α beyond the limits."""

from collections.abc import Sequence

import numpy as np

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.magnification import Magnification
from tg4mm.fit.motion.mode_selection import worth_keeping
from tg4mm.fit.motion.observations import check_band_resolved
from tg4mm.run import Run
from tg4mm.run.preset import method_of
from tg4mm.show.result.model import Band, Result, with_deviation
from tg4mm.show.result.read import result_from, result_of
from tg4mm.show.result.reading import NOISE_PX, TURN, MagnificationLimits, reading_of

_LISTED = 8  # modes
_LET_THROUGH = 0.05  # of a filter's response: less counts as outside the band


def auto_band(run: Run) -> tuple[Band, str]:
    """Return the band of `--band auto`, around the strongest vibration, and a line that states it.

    Raises Tg4mmError without a vibration.
    """
    result = result_of(run)
    if result.band is None:
        raise Tg4mmError(
            f"--band auto: no vibration was found in {run.path}; --band LO HI selects a band anyway"
        )
    line = f"--band auto: {_shown(result.band)} Hz, around {result.vibrations[0].hz:.4g} Hz"
    if others := result.vibrations[1:]:
        line += f", the strongest; there are also {', '.join(f'{v.hz:.4g}' for v in others)} Hz"
    return result.band, line


def refuse_empty(run: Run, plan: Magnification) -> None:
    """Raise Tg4mmError for a band of the plan without motion; the message lists the frequencies with motion.

    Modes of noise alone (`mode_selection.py`) do not count.
    """
    motion = run.load_motion()
    if motion is None or not plan.bands:
        return
    plan.checked(motion.fps)
    for band in plan.bands:
        check_band_resolved(band.band, motion.n_timesteps / motion.fps)
    freqs = motion.freqs_hz[worth_keeping(motion, run.load_noise()) & motion.is_magnified()]
    is_modal = method_of(run, plan) == "modal"
    for band in plan.bands:
        one = Magnification.of(1.0, band.band, method=plan.method, filter=plan.filter)
        gains = one.ideal(freqs) if is_modal else np.abs(one.response(freqs, motion.fps))
        if not (gains > _LET_THROUGH).any():
            raise Tg4mmError(
                f"--band {band.low:g} {band.high:g}: no motion was found there; {_there(result_of(run), freqs)}; "
                f"--allow-empty-band continues anyway, tg4mm train --band {band.low:g} {band.high:g} fits one"
            )


def how_sure(run: Run, plan: Magnification) -> list[str]:
    """Return a line with the motion and its ± for each band of the plan in which nothing stands out."""
    if run.load_motion() is None:
        return []
    reading, out = reading_of(run), []
    for band in plan.limits:
        for v in result_from(reading, band).vibrations:
            if v.doubt and v.band == band:
                length = v.amplitude if v.pixels is None else v.pixels
                unit = "scene units" if v.pixels is None else "px"
                out.append(
                    f"--band {_shown(band)}: {with_deviation(length)} {unit} at {v.hz:.3g} Hz: {v.doubt}"
                )
    return out


def reversed_motion(plan: Magnification) -> str | None:
    """Return a line if α is below −1, otherwise None."""
    least = min([*(b.alpha for b in plan.bands), plan.everywhere])
    if least >= -1:
        return None
    return f"α = {least:g}: the motion is shown reversed, {-1 - least:.3g} times as large; -1 stops it, 0 leaves it"


def too_far(run: Run, plan: Magnification) -> str | None:
    """Return a line if the magnified motion exceeds its limits or its noise becomes visible, otherwise None."""
    motion = run.load_motion()
    if motion is None or plan.is_identity:
        return None
    if method_of(run, plan) == "modal":
        alphas = plan.ideal(motion.freqs_hz) * motion.is_magnified()
    else:
        alphas = plan.response(motion.freqs_hz, motion.fps)
    gains = np.where(alphas != 0, np.abs(1 + alphas), 0.0)
    limits = reading_of(run).limits(gains)
    if limits is None or not limits.too_far > 1:
        return None
    alpha = plan.alpha
    moved = "" if limits.pixels is None else f"the largest motion becomes {limits.pixels:.3g} px; "
    most = abs(1 + alpha) / limits.too_far - 1  # all limits are proportional to |1 + α|
    within = "the motion as captured exceeds this, too"
    if most > 0:
        within = f"α = {float(f'{most:.2g}'):g} is the limit"
    return f"α = {alpha:g}: {moved}{'; '.join(_reasons(limits))}; {within}"


def _reasons(limits: MagnificationLimits) -> list[str]:
    out = []
    if limits.turn > TURN:
        out.append(
            f"parts turn or shear by {limits.turn:.2g} rad, and from {TURN:g} on shapes stretch, by 12 % and more, "
            "and tear"
        )
    if (limits.noise_px or 0.0) > NOISE_PX:
        out.append(f"noise is magnified to {limits.noise_px:.2g} px and looks like motion")
    return out


def _there(result: Result, freqs: np.ndarray) -> str:
    if not result.vibrations:  # such as a record of less than two periods
        modes = ", ".join(f"{f:.4g}" for f in freqs[:_LISTED])
        return (
            f"no vibration stands out, and the modes lie at {modes} Hz" if modes else "there is none at all"
        )
    return "there is " + ", ".join(f"{v.hz:.4g} Hz (--band {_shown(v.band)})" for v in result.vibrations)


def _shown(band: Sequence[float]) -> str:
    return f"{band[0]:g} {band[1]:g}"
