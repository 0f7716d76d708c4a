"""Lines that a stronger one may have caused: through the codec, or as its multiples."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from scipy import ndimage

from tg4mm.capture.look.baseline import BLOCK
from tg4mm.capture.look.model import LookLine
from tg4mm.capture.look.scene import PATTERNS, Light
from tg4mm.capture.look.search import images
from tg4mm.core.lines import alias

_WEAK = 30.0  # times weaker beside a line: what a codec makes of it
_LARGER = 2.0  # times the amplitude of a line that others are made of
_MULTIPLES = (2, 3, 4)
# A codec that skips small changes is an odd function of the motion, and makes more multiples. They are marked up to
# 1 / n of it, the size that they have in a square wave; a larger line may be a vibration.
_OF_CODEC = (5, 7)
_INEXACT = 0.015  # of a line's amplitude: the error of its shift (kernel and series), of which other lines may be made
_EXACT_PX = 0.6  # up to here the series of a cell's shift is exact
_LIGHT_PX = 0.3  # that light seems to move a place by, a unit of its change: what gain and offset leave of it
# the most that light, which is no gain in clipped highlights, can seem to move a place by, a unit of its change:
# brightness over its slope, I / |∇I|, of weak texture
_LIGHT_MOST_PX = 15.0
_SHOWS, _SURE = 3, 3.0  # cells in which a line shows, and deviations of it, that are no accident of one cell


def marked(
    lines: list[LookLine],
    rate: float,
    duration_s: float,
    patterns: tuple[int, ...] = PATTERNS,
    taken_off: Mapping[float, str] = MappingProxyType({}),
    light: Sequence[Light] = (),
    clipped: np.ndarray | None = None,
) -> list[LookLine]:
    """Return the lines, each marked with the reason why it may be an artefact.

    patterns: periods of the codec's frame kinds; none: it makes no line of another. taken_off: frequencies in Hz of
    another origin, which marks everything that the record does not resolve from them. light: its lines.
    clipped [rows, columns] bool: cells with clipped highlights.
    """
    marks = [_mark(line, lines, rate, duration_s, patterns, taken_off) for line in lines]
    marked_lines = [replace(line, mark=mark) for line, mark in zip(lines, marks, strict=True)]
    return [_beside_light(line, light, duration_s, clipped) for line in marked_lines]


def _beside_light(
    line: LookLine, light: Sequence[Light], duration_s: float, clipped: np.ndarray | None
) -> LookLine:
    """Add the apparent motion by light of its frequency to the line's ±; mark it if light may explain all of it."""
    is_clipped = clipped is not None and bool((line.region & clipped).any())
    for lamp in light:
        if abs(lamp.hz - line.hz) < 1 / duration_s:
            seems = _LIGHT_PX * lamp.amplitude
            why = f"no more than light makes seem to move that flickers at {lamp.hz:.4g} Hz"
            deviation = float(np.hypot(line.amplitude_deviation_px, seems))
            if line.amplitude_px - 2 * min(line.amplitude_deviation_px, seems) < seems:
                mark = why
            elif is_clipped and line.amplitude_px < _LIGHT_MOST_PX * lamp.amplitude:
                mark = line.mark or f"may be light, which flickers at {lamp.hz:.4g} Hz"
            else:
                mark = line.mark
            return replace(line, amplitude_deviation_px=deviation, mark=mark)
    return line


@dataclass(frozen=True)
class _Near:
    line: LookLine
    resolution_hz: float

    def __call__(self, hz: float, other: LookLine, times: int = 1) -> bool:
        known = 3 * np.hypot(self.line.hz_deviation, times * other.hz_deviation)
        return bool(abs(hz - self.line.hz) < max(0.5 * self.resolution_hz, known))


def _mark(
    line: LookLine,
    lines: list[LookLine],
    rate: float,
    duration_s: float,
    patterns: tuple[int, ...],
    taken_off: Mapping[float, str],
) -> str:
    if _is_inexact(line):
        return f"one cell alone, and more than {_EXACT_PX:g} px, where its shift is not exact"
    if beside := _beside_taken(line, taken_off, duration_s):
        return beside
    near = _Near(line, 1 / duration_s)
    others = [one for one in lines if not _is_inexact(one) and not _beside_taken(one, taken_off, duration_s)]
    for other in others:
        if other.amplitude_px >= _LARGER * line.amplitude_px:
            for n in _MULTIPLES:
                if near(alias(n * other.hz, rate), other, n):
                    return f"{n} × {other.hz:.3f} Hz"
            for n in _OF_CODEC if patterns and _is_there(line, other) else ():
                if other.amplitude_px >= n * line.amplitude_px and near(alias(n * other.hz, rate), other, n):
                    return f"{n} × {other.hz:.3f} Hz, which the codec may make"
            if _is_there(line, other) and any(
                near(image, other) for image in images(other.hz, rate, patterns)
            ):
                return f"image of {other.hz:.3f} Hz by a pattern of pictures, of the codec or a conversion"
    for other in others:
        if line.amplitude_px < _INEXACT * other.amplitude_px and _is_there(line, other):
            return f"under {100 * _INEXACT:.2g} % of {other.hz:.3f} Hz: the error of its shift may make it"
    for other in lines if patterns else ():
        if other.statistic > _WEAK * line.statistic and _is_there(line, other):
            return f"weak beside {other.hz:.3f} Hz: the codec may make it of that"
    return ""


def _beside_taken(line: LookLine, taken_off: Mapping[float, str], duration_s: float) -> str:
    """Return the mark of a line at a frequency that was removed from the shifts; empty if there is none."""
    for hz, whose in taken_off.items():
        if abs(hz - line.hz) < 1 / duration_s:
            return f"nearer to {whose} {hz:.4g} Hz than the record resolves"
    return ""


def _is_inexact(line: LookLine) -> bool:
    """Return whether a line is large and measured in one cell alone."""
    is_sure = line.cells.sum() >= _SHOWS and line.amplitude_px > _SURE * line.amplitude_deviation_px
    return bool(line.amplitude_px > _EXACT_PX and line.region.sum() == 1 and not is_sure)


def _is_there(line: LookLine, other: LookLine) -> bool:
    """Return whether two lines share a place: a codec's artefacts appear where the motion is."""
    return bool((line.cells & ndimage.binary_dilation(other.cells, BLOCK)).any())
