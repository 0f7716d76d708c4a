"""Charts as inline SVG: bars of a spectrum, scores over magnification, colour bars. Text comes out escaped.

Colours are CSS variables of the page (--ink, --muted, --rule, --ours, …), so charts follow light and dark.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from markupsafe import Markup, escape

from tg4mm.report.colour import amount_colours, hex_colour, phase_colours

WIDTH, HEIGHT = 640, 290
LEFT, RIGHT, TOP, BOTTOM = 76, 16, 18, 50
_LABELS = 124  # units for the labels at the right end of curves
_BETWEEN = 17  # units from one label down to the next


@dataclass(frozen=True)
class Series:
    """One curve of a chart."""

    label: str
    values: Sequence[float | None]  # None: no point there
    style: str  # CSS class: ours, ceiling, still
    breaks: Sequence[int] = ()  # positions that no line leads to from the one before


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
    return f"{mantissa.rstrip('0').rstrip('.')}·10{_superscript(int(exponent))}"


def _superscript(value: int) -> str:
    return str(value).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def score_chart(x_names: Sequence[str], series: Sequence[Series], x_label: str, y_label: str) -> Markup:
    """Curves over named positions, evenly spaced, each labelled at its right end.

    Labels stay above the names of the positions, as long as there are no more of them than `below` says.
    """
    values = [v for s in series for v in s.values if v is not None]
    low, high = (min(values), max(values)) if values else (0.0, 1.0)
    margin = (high - low) * 0.1 or 0.01
    low, high = low - margin, high + margin
    spread = (WIDTH - LEFT - RIGHT - _LABELS) / max(len(x_names) - 1, 1)
    right = WIDTH - RIGHT - _LABELS + 18
    parts = [_frame(y_label, x_label, right), _y_axis(low, high, right)]
    for i, name in enumerate(x_names):
        parts.append(_text(LEFT + 12 + i * spread, HEIGHT - BOTTOM + 18, name, "middle"))
    ends = []
    for one in series:
        points = {
            i: (LEFT + 12 + i * spread, _y(v, low, high)) for i, v in enumerate(one.values) if v is not None
        }
        if not points:
            continue
        for first, last in pairwise([0, *one.breaks, len(one.values)]):
            path = " ".join("{:.1f},{:.1f}".format(*points[i]) for i in range(first, last) if i in points)
            parts.append(Markup('<polyline class="line-{}" points="{}"/>').format(one.style, path))
        for x, y in points.values():
            parts.append(
                Markup('<circle class="fill-{}" cx="{:.1f}" cy="{:.1f}" r="3.6"/>').format(one.style, x, y)
            )
        ends.append((points[max(points)], one))
    for y, ((x, _), one) in zip(_apart([end[0][1] for end in ends]), ends, strict=True):
        parts.append(_text(x + 12, y + 4, one.label, "start", f"label-{one.style}"))
    return _svg(parts, f"{y_label} over {x_label}")


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


def below(labels: int) -> int:
    """By how many units so many labels at the right end reach below the positions' line."""
    return max(0, TOP + _BETWEEN * (labels - 1) - (HEIGHT - BOTTOM))


def _apart(ys: list[float]) -> list[float]:
    """Heights of labels, in the order given: moved down so as not to lie on each other, and up again from the end."""
    order = sorted(range(len(ys)), key=lambda i: ys[i])
    placed = list(ys)
    for before, after in pairwise(order):
        placed[after] = max(placed[after], placed[before] + _BETWEEN)
    lowest = float(HEIGHT - BOTTOM + below(len(ys)))
    for i in reversed(order):
        placed[i] = min(placed[i], lowest)
        lowest = placed[i] - _BETWEEN
    return placed


def _y(value: float, low: float, high: float) -> float:
    return HEIGHT - BOTTOM - (value - low) / (high - low) * (HEIGHT - TOP - BOTTOM)


def _y_axis(low: float, high: float, right: float = WIDTH - RIGHT) -> Markup:
    parts = []
    ticks = nice_ticks(low, high)
    for tick in ticks:
        y = _y(tick, low, high)
        parts += [
            _line(LEFT, y, right, y, "rule"),
            _text(LEFT - 10, y + 4, _tick(tick, ticks), "end"),
        ]
    return Markup("").join(parts)


def _tick(value: float, ticks: Sequence[float]) -> str:
    """A tick with as many decimals as all of them need."""
    step = ticks[1] - ticks[0] if len(ticks) > 1 else abs(value) or 1.0
    if step < 1e-4:
        return number(value, 4)
    places = next(p for p in range(6) if p == 5 or abs(round(step, p) - step) < 1e-9 * step)
    return f"{value:.{places}f}" if value else "0"


def _frame(y_label: str, x_label: str, right: float = WIDTH - RIGHT) -> Markup:
    middle = TOP + (HEIGHT - TOP - BOTTOM) / 2
    turned = Markup(
        '<text class="axis" text-anchor="middle" transform="translate(15 {:.0f}) rotate(-90)">{}</text>'
    )
    return turned.format(middle, y_label) + _text((LEFT + right) / 2, HEIGHT - 6, x_label, "middle", "axis")


def _line(x1: float, y1: float, x2: float, y2: float, style: str) -> Markup:
    return Markup('<line class="line-{}" x1="{:.1f}" y1="{:.1f}" x2="{:.1f}" y2="{:.1f}"/>').format(
        style, x1, y1, x2, y2
    )


def _text(x: float, y: float, text: str, anchor: str, style: str = "tick") -> Markup:
    return Markup('<text class="{}" x="{:.1f}" y="{:.1f}" text-anchor="{}">{}</text>').format(
        style, x, y, anchor, text
    )


def _svg(parts: Sequence[Markup], label: str) -> Markup:
    head = Markup('<svg class="chart" viewBox="0 0 {} {}" role="img" aria-label="{}">').format(
        WIDTH, HEIGHT, escape(label)
    )
    return head + Markup("").join(parts) + Markup("</svg>")
