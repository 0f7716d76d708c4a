"""Words and units of the report."""

from __future__ import annotations

from collections.abc import Sequence

from tg4mm.core.pages.svg import number

from .dataset import Dataset


def length(value: float, unit_scale_m: float | None) -> str:
    """A length in scene units, and in metres where the scale is known."""
    text = f"{number(value)} units"
    return text if unit_scale_m is None else f"{text} ({metres(value * unit_scale_m)})"


def metres(value: float) -> str:
    """Metres as m, mm or µm."""
    for unit, factor in (("m", 1.0), ("mm", 1e-3)):
        if abs(value) >= factor:
            return f"{number(value / factor)} {unit}"
    return f"{number(value / 1e-6)} µm"


def unit_of(dataset: Dataset) -> tuple[str, float]:
    """Unit of lengths in charts, and the factor that scene units are multiplied with."""
    if dataset.unit_scale_m is None:
        return "scene units", 1.0
    largest = dataset.amplitude * dataset.unit_scale_m
    for unit, factor in (("m", 1.0), ("mm", 1e-3)):
        if largest >= factor:
            return unit, dataset.unit_scale_m / factor
    return "µm", dataset.unit_scale_m / 1e-6


def hertz(frequencies: Sequence[float]) -> str:
    """Different frequencies as "3 Hz and 5 Hz"."""
    words = [f"{number(f)} Hz" for f in sorted(set(frequencies))]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def percent(share: float) -> str:
    """A share of 1 in per cent."""
    return f"{number(100 * share)} %"


def decibel(value: float | None) -> str:
    """A PSNR with two decimals, a dash if there is none; equal pictures have the largest there is."""
    if value is None:
        return "–"
    return "equal" if value >= 100 else f"{value:.2f}"


def similarity(value: float | None) -> str:
    """An SSIM with four decimals."""
    return "–" if value is None else f"{value:.4f}"


def plural(count: int, word: str) -> str:
    """ "1 camera", "2 cameras"."""
    return f"{count:,} {word}{'' if count == 1 else 's'}"
