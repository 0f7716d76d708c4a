"""A motion over time, and its spectrum, as inline SVG."""

from __future__ import annotations

from typing import Any

import numpy as np
from markupsafe import Markup

from tg4mm.core.pages.charts import OURS, STILL, chart

_BAR = 0.6  # width, by the distance of two frequencies


def time_chart(times_s: np.ndarray, values: np.ndarray, unit: str) -> Markup:
    """A displacement [T] at times [T] with a dot at every sample; the scale reaches as far below zero as above."""
    span = float(np.abs(values).max(initial=0.0)) * 1.1 or 1.0

    def draw(axes: Any) -> None:
        axes.plot(times_s, values, "o-", color=OURS, linewidth=1.6, markersize=3.5)
        axes.set(xlabel="time (s)", ylabel=f"displacement ({unit})", ylim=(-span, span))

    return chart(draw, f"displacement ({unit}) over time (s)")


def spectrum_chart(freqs_hz: np.ndarray, amplitudes: np.ndarray, unit: str, strong: np.ndarray) -> Markup:
    """Amplitudes [F] at evenly spaced frequencies [F] as bars, those that are `strong` [F] in the colour of results."""
    width = _BAR * float(freqs_hz[1] - freqs_hz[0]) if len(freqs_hz) > 1 else _BAR

    def draw(axes: Any) -> None:
        axes.set_axisbelow(True)
        axes.bar(freqs_hz, amplitudes, width, color=np.where(strong, OURS, STILL))
        axes.set(xlabel="frequency (Hz)", ylabel=f"amplitude ({unit})")

    return chart(draw, f"amplitude ({unit}) over frequency (Hz)")
