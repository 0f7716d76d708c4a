"""Colour bars as inline SVG, whose text follows light and dark; round numbers for axes and tables."""

import math
import zlib

import numpy as np
from markupsafe import Markup

from tg4mm.core.colour import amount_colours, hex_colour, phase_colours

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def nice_ticks(low: float, high: float, about: int = 5) -> list[float]:
    """Round numbers (1, 2, 2.5 or 5 times a power of ten apart) that lie in low..high."""
    if not (math.isfinite(low) and math.isfinite(high)) or high <= low:
        return [low]
    raw = (high - low) / max(about - 1, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(m * power for m in (1, 2, 2.5, 5, 10) if m * power >= raw * (1 - 1e-9))
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [float(i * step) for i in range(first, last + 1)]


def number(value: float, digits: int = 3, trim: bool = True) -> str:
    """A number to `digits` significant figures, without an exponent where that stays short.

    `trim` drops zeros at the end, as one does outside tables.
    """
    if value == 0:
        return "0"
    if not math.isfinite(value):
        return "–"
    if 1e-4 <= abs(value) < 1e6:
        places = max(0, digits - 1 - math.floor(math.log10(abs(value))))
        text = f"{value:.{places}f}"
        return text.rstrip("0").rstrip(".") if "." in text and trim else text
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return f"{mantissa.rstrip('0').rstrip('.')}·10{str(int(exponent)).translate(_SUPERSCRIPT)}"


def size_text(size: int) -> str:
    """Bytes as 12.3 kB, 4.56 MB (powers of ten)."""
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= factor:
            return f"{number(size / factor)} {unit}"
    return f"{size} B"


def colour_bar(top: float, unit: str, label: str) -> Markup:
    """A bar of the map for amounts with ticks from 0 to `top`."""
    ticks = [(t / top, number(t)) for t in nice_ticks(0.0, top, 5)] if top > 0 else [(0.0, "0")]
    stops = [(s, hex_colour(amount_colours(np.array(s)))) for s in np.linspace(0, 1, 13)]
    return _bar(stops, ticks, f"{label} ({unit})" if unit else label)


def phase_bar() -> Markup:
    """A bar of the closed colour map with ticks from −180° to 180°."""
    ticks = [((d + 180) / 360, f"{d}°".replace("-", "−")) for d in (-180, -90, 0, 90, 180)]
    stops = [(s, hex_colour(phase_colours(np.array((s - 0.5) * 2 * np.pi)))) for s in np.linspace(0, 1, 25)]
    return _bar(stops, ticks, "phase at timestep 0")


def _bar(stops: list[tuple[float, str]], ticks: list[tuple[float, str]], label: str) -> Markup:
    width, inset = 360, 24
    name = f"g{zlib.crc32(f'{stops}{label}'.encode()):08x}"
    gradient = Markup("").join(
        Markup('<stop offset="{:.3f}" stop-color="{}"/>').format(float(s), colour) for s, colour in stops
    )
    parts = [
        Markup('<defs><linearGradient id="{}">{}</linearGradient></defs>').format(name, gradient),
        Markup('<rect x="{}" y="4" width="{}" height="12" rx="2" fill="url(#{})"/>').format(
            inset, width - 2 * inset, name
        ),
    ]
    for share, text in ticks:
        x = inset + share * (width - 2 * inset)
        parts += [_line(x, 16, x, 21, "rule"), _text(x, 34, text, "middle")]
    parts.append(_text(width / 2, 52, label, "middle", "axis"))
    body = Markup("").join(parts)
    return Markup('<svg class="colourbar" viewBox="0 0 {} 58" role="img" aria-label="{}">{}</svg>').format(
        width, label, body
    )


def _line(x1: float, y1: float, x2: float, y2: float, style: str) -> Markup:
    return Markup('<line class="line-{}" x1="{:.1f}" y1="{:.1f}" x2="{:.1f}" y2="{:.1f}"/>').format(
        style, x1, y1, x2, y2
    )


def _text(x: float, y: float, text: str, anchor: str, style: str = "tick") -> Markup:
    return Markup('<text class="{}" x="{:.1f}" y="{:.1f}" text-anchor="{}">{}</text>').format(
        style, x, y, anchor, text
    )
