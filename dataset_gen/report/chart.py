"""A chart over time as inline SVG, in the style of the other charts of tg4mm's pages."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from tg4mm.report.svg import nice_ticks, number

_WIDTH, _HEIGHT = 640, 290
_LEFT, _RIGHT, _TOP, _BOTTOM = 76, 16, 18, 50


def time_chart(times: np.ndarray, values: np.ndarray, x_label: str, y_label: str) -> Markup:
    """One curve with a dot at every sample; the scale reaches equally far below and above zero."""
    span = float(np.abs(values).max(initial=0.0)) * 1.1 or 1.0
    last = float(times.max(initial=0.0)) or 1.0

    def x(time: float) -> float:
        return _LEFT + time / last * (_WIDTH - _LEFT - _RIGHT)

    def y(value: float) -> float:
        return _TOP + (span - value) / (2 * span) * (_HEIGHT - _TOP - _BOTTOM)

    parts = []
    for tick in nice_ticks(-span, span):
        parts.append(_line(_LEFT, y(tick), _WIDTH - _RIGHT, y(tick)))
        parts.append(_text(_LEFT - 10, y(tick) + 4, number(tick).replace("-", "−"), "end"))
    for tick in nice_ticks(0.0, last, 7):
        parts.append(_text(x(tick), _HEIGHT - _BOTTOM + 18, number(tick), "middle"))
    points = [(x(t), y(v)) for t, v in zip(times.tolist(), values.tolist(), strict=True)]
    path = " ".join(f"{a:.1f},{b:.1f}" for a, b in points)
    parts.append(Markup('<polyline class="line-ours" points="{}"/>').format(path))
    dot = Markup('<circle class="fill-ours" cx="{:.1f}" cy="{:.1f}" r="2.6"/>')
    parts += [dot.format(a, b) for a, b in points]
    middle = (_LEFT + _WIDTH - _RIGHT) / 2
    parts.append(_text(middle, _HEIGHT - 6, x_label, "middle", "axis"))
    turned = '<text class="axis" text-anchor="middle" transform="translate(15 {:.0f}) rotate(-90)">{}</text>'
    parts.append(Markup(turned).format(_TOP + (_HEIGHT - _TOP - _BOTTOM) / 2, y_label))
    head = Markup('<svg class="chart" viewBox="0 0 {} {}" role="img" aria-label="{}">')
    return (
        head.format(_WIDTH, _HEIGHT, f"{y_label} over {x_label}") + Markup("").join(parts) + Markup("</svg>")
    )


def _line(x1: float, y1: float, x2: float, y2: float) -> Markup:
    return Markup('<line class="line-rule" x1="{:.1f}" y1="{:.1f}" x2="{:.1f}" y2="{:.1f}"/>').format(
        x1, y1, x2, y2
    )


def _text(x: float, y: float, text: str, anchor: str, style: str = "tick") -> Markup:
    return Markup('<text class="{}" x="{:.1f}" y="{:.1f}" text-anchor="{}">{}</text>').format(
        style, x, y, anchor, text
    )
