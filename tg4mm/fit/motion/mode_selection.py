"""Selection of modes: which are peaks, which are noise, and which may be artefacts."""

from collections.abc import Sequence

import numpy as np

from tg4mm.core.lines.model import log_floor
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.motion.observations import Observations
from tg4mm.fit.motion.spectrum import all_but_weakest

_MAINS_HZ = (100.0, 120.0)  # light flickers at twice the mains' 50 or 60 Hz
_NEAR_NYQUIST = 0.8
_HIGHEST = 0.999  # of half the frame rate: from there on no band can hold a frequency
_PEAK = 0.03  # of the strongest mode's rms: what counts as a peak
_ABOVE_FLOOR = 6.0  # times the median mode's rms, where there are modes enough for most of them to be noise
_ENOUGH_MODES = 12
_ABOVE_TREND = 3.0  # times the rms that modes have at that frequency
_STANDS_OUT = 4.0  # robust deviations of its logarithm
_APART = 1 + 1e-6  # neighbouring bins, whose distance is rounded, are not apart
_STRAY = 99.0  # percentile: Gaussians that hardly any camera sees must not say how large the noise is
_ROUNDING = 1e-12  # of the motion's power: what float32 does not hold
_OF_MOTION = 1e-6  # of the motion's power, where the run does not say its noise


def peaks(
    motion: ModalMotion, lowest_hz: float, noise: np.ndarray | None = None, known_hz: Sequence[float] = ()
) -> np.ndarray:
    """Return [K] Hz by falling strength: modes with two periods in the record, no weaker than 3 % of the strongest.

    Below half the frame rate, where cosine and sine are distinct.
    Of many modes most are noise: then a peak is six times the median one too. And a drift, which is spread over
    frequencies, has no peak: one is three times what rms falls to with frequency, and four robust deviations above it.
    A frequency counts once, by its strongest mode: what lies within half the lowest frequency of a stronger mode is its
    flank, or that of a drift. Where `noise` [N] is known (standard deviation of each Gaussian's displacement, scene
    units), no mode is a peak that may be noise: of few modes, which have no floor of their own, one is to have more
    power than all noise. known_hz: of vibrations that regions showed: a part of the scene may move at them alone, which
    its mean does not show, and the mode there is a peak all the same.
    """
    rms = np.sqrt(motion.powers() / motion.n_gaussians)
    is_able = motion.freqs_hz >= lowest_hz
    able = rms[is_able]
    least = np.full(len(rms), _PEAK * able.max(initial=0))
    if len(able) >= _ENOUGH_MODES:
        floor, spread = log_floor(able, motion.freqs_hz[is_able], np.ones(len(able), bool))
        trend = np.exp(floor + max(_STANDS_OUT * spread, np.log(_ABOVE_TREND)))
        least[is_able] = np.maximum(trend, np.maximum(least[is_able], _ABOVE_FLOOR * float(np.median(able))))
    elif noise is not None:
        least = np.maximum(least, np.sqrt(2 * _typical_power(noise)))
    strongest_first = np.argsort(rms)[::-1]
    hz = np.asarray(motion.freqs_hz, np.float64)[strongest_first]
    apart = _APART * lowest_hz / 2
    is_top = np.array([(np.abs(hz[:i] - f) > apart).all() for i, f in enumerate(hz)], bool)
    is_between = (hz >= lowest_hz) & (hz < _HIGHEST * motion.fps / 2)
    is_peak = (rms >= least) & worth_keeping(motion, noise)
    for known in known_hz:
        away = np.abs(motion.freqs_hz - known)
        is_peak |= (away == away.min(initial=np.inf)) & (away < lowest_hz / 4)  # half a bin
    return hz[is_top & is_peak[strongest_first] & is_between]


def frequency_notes(hz: Sequence[float] | np.ndarray, observations: Observations) -> list[str]:
    """Frequencies at which flickering light or a faster vibration would look the same."""
    fps, resolution = observations.fps, 1 / observations.duration_s
    out = []
    for f in hz:
        for mains in _MAINS_HZ:
            alias = abs(mains - round(mains / fps) * fps)
            if alias > resolution and abs(f - alias) < resolution / 2:
                out.append(
                    f"{f:.4g} Hz is where light that flickers at {mains:g} Hz appears at {fps:.4g} frames/s: "
                    "switch the light off, or change the frame rate, to distinguish it from motion"
                )
        period = observations.codec_period or 1
        for k in range(1, period // 2 + 1):
            if abs(f - k * fps / period) < resolution / 2:
                out.append(
                    f"{f:.4g} Hz is a repetition of the video's compression ({k} × {fps:.4g} Hz / {period} frames): "
                    "less compression, or another frame rate, distinguishes it from motion"
                )
        if f > _NEAR_NYQUIST * fps / 2:
            out.append(
                f"{f:.4g} Hz is close to half the frame rate: a vibration of {fps - f:.4g} Hz would look the same; "
                "a higher frame rate distinguishes them"
            )
    return out


def worth_keeping(motion: ModalMotion, noise: np.ndarray | None) -> np.ndarray:
    """Return [K] bool: all but the weakest modes, as long as those are together (mean square) less than the noise.

    noise [N]: standard deviation of each Gaussian's displacement by noise, scene units; None: not known, then a
    millionth of the motion's power takes its place. 0 Hz is kept: it is where the motion's own zero lies.
    """
    power = motion.powers() / (2 * motion.n_gaussians)
    oscillates = np.asarray(motion.freqs_hz) > 0
    total = float(power[oscillates].sum())
    allowed = _OF_MOTION * total
    if noise is not None and len(noise):
        allowed = max(_ROUNDING * total, _typical_power(noise))
    return all_but_weakest(power, oscillates, allowed)


def _typical_power(noise: np.ndarray) -> float:
    """Return the mean square of noise [N], with stray Gaussians limited to the level of the others."""
    usual = np.minimum(noise, np.percentile(noise, _STRAY)).astype(np.float64)
    return float((usual**2).mean())
