"""Frequency bands in Hz, and what makes one valid at a frame rate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Real

from tg4mm.core.errors import CaptureError


def check_band(band: Sequence[float], fps: float) -> tuple[float, float]:
    """The band as (low, high) in Hz, if 0 ≤ low < high < fps / 2; CaptureError otherwise."""
    numbers = list(band) if isinstance(band, Sequence) and not isinstance(band, str) else []
    if len(numbers) != 2 or not all(isinstance(x, Real) and math.isfinite(x) for x in numbers):
        raise CaptureError(f"band {band!r} is not two frequencies in Hz, low and high")
    low, high = float(numbers[0]), float(numbers[1])
    if not (math.isfinite(fps) and fps > 0):
        raise CaptureError(f"band ({low:g}, {high:g}) Hz needs a frame rate, and fps is {fps:g} (unknown)")
    if low < 0:
        raise CaptureError(f"band ({low:g}, {high:g}) Hz starts below 0 Hz")
    if low >= high:
        raise CaptureError(f"band ({low:g}, {high:g}) Hz is empty: low must be below high")
    if high >= fps / 2:
        raise CaptureError(
            f"band ({low:g}, {high:g}) Hz reaches past half the frame rate, {fps / 2:g} Hz (fps = {fps:g})"
        )
    return low, high
