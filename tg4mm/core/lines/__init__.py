"""Lines: the frequencies, decays, amplitudes and phases that a series over time holds, with their covariance.

    found = find_lines(values, times_s)          # [T] or [T, D] of anything, [T] seconds; what stands out by itself
    for line in found.lines:                     # by falling strength
        line.hz, line.hz_deviation               # Hz; in (0, half the rate)
        line.phasor, line.amplitude_deviation    # [D] complex, [D]: u(t) = envelope(t) Re[phasor exp(i 2π f t)]
        line.damping, line.damping_deviation     # ζ = decay / (2π f), None unless a test says that it rings down
        line.change                              # "steady", "decays", "grows", "begins", "varies" or "untold", tested
        line.modulation                          # rms of what changes slowly beside that, relative; 0: none detected
    fit_line_near(values, times_s, hz, half_hz)      # the one line at a frequency that is known to within half_hz
    fit_lines(values, times_s, hz)               # the same at frequencies [K] that are known to within a bin, or with
                                                 # the frequencies and envelopes of other lines [K]

This is the one estimate of a frequency in tg4mm: training, sensors, renders and reports all take it from here.
"""

from tg4mm.core.lines.find import find_lines, fit_line_near, fit_lines, projected
from tg4mm.core.lines.record import FEWEST, CodecChange, Line, Lines, alias, envelope, tone

__all__ = [
    "FEWEST",
    "CodecChange",
    "Line",
    "Lines",
    "alias",
    "envelope",
    "find_lines",
    "fit_line_near",
    "fit_lines",
    "projected",
    "tone",
]
