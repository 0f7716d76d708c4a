"""Charts of the panel, a spectrum with peaks to click and a waveform, as inline SVG in the browser's colours."""

import json
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from markupsafe import Markup

from tg4mm.capture.look import LookSummary
from tg4mm.core.colour import amount_colours, hex_colour
from tg4mm.core.digits import nice_ticks, number
from tg4mm.show.view.colours import Band

_NOTHING = Markup("")
WIDTH, HEIGHT = 360, 140
LEFT, RIGHT, TOP, BOTTOM = 60, 10, 10, 36
ACCENT = hex_colour(amount_colours(np.array(0.62)))  # from the report's map, visible on light and dark
ACCENT_RGB = int(ACCENT[1:3], 16), int(ACCENT[3:5], 16), int(ACCENT[5:7], 16)
STYLE = (  # of the page
    ".tg4mm{padding:0 .5em .25em;font-size:.8rem;line-height:1.35;color:var(--mantine-color-text)}"
    ".tg4mm p{margin:.25em 0}.tg4mm .dim{color:var(--mantine-color-dimmed)}"
    ".tg4mm svg{display:block;width:100%;height:auto;overflow:visible}"
    ".tg4mm text{fill:var(--mantine-color-dimmed);font-size:11px;font-variant-numeric:tabular-nums}"
    ".tg4mm .line-rule{stroke:var(--mantine-color-default-border)}"
    f".tg4mm .stem{{stroke:var(--mantine-color-dimmed);stroke-width:3}}.tg4mm .in{{stroke:{ACCENT}}}"
    f".tg4mm .curve{{fill:none;stroke:{ACCENT};stroke-width:1.6;stroke-linejoin:round}}"
    f".tg4mm .spread{{fill:{ACCENT};fill-opacity:.25}}.tg4mm .band{{fill:{ACCENT};fill-opacity:.14}}"
    ".tg4mm .floor{stroke:var(--mantine-color-dimmed);stroke-dasharray:4 3;fill:none}"
    ".tg4mm .now{stroke:var(--mantine-color-text);stroke-width:1}"
    ".tg4mm svg[data-span]{cursor:crosshair;touch-action:pan-y}.tg4mm .cursor{pointer-events:none}"
    ".tg4mm .cursor text{fill:var(--mantine-color-text)}"
    ".tg4mm .hit{fill:transparent;cursor:pointer}.tg4mm .hit:hover{fill:var(--mantine-color-default-hover)}"
)
# A click on a peak presses the button of the same name below the chart.
BAND_FIELD = "From, to (Hz)"  # of the panel: a drag over a spectrum fills it
_SIZES = {"WIDTH": WIDTH, "HEIGHT": HEIGHT, "LEFT": LEFT, "RIGHT": RIGHT, "TOP": TOP, "BOTTOM": BOTTOM}
SCRIPT = "".join(
    f"const {name} = {json.dumps(value)};\n" for name, value in (*_SIZES.items(), ("BAND_FIELD", BAND_FIELD))
) + (Path(__file__).parent / "page.js").read_text(encoding="utf-8")


def block(*parts: str | Markup) -> str:
    """Return paragraphs (text, escaped) and drawings (markup) as one block of the panel."""
    body = Markup("").join(p if isinstance(p, Markup) else Markup("<p>{}</p>").format(p) for p in parts if p)
    return str(Markup('<div class="tg4mm">{}</div>').format(body))


def key_words(keys: Sequence[tuple[str, str]]) -> Markup:
    """Return the keys of the page; each presses a button with one of the names, separated by "|"."""
    each = Markup('<kbd data-key="{}" data-press="{}">{}</kbd> {}')
    parts = [
        each.format(key, names, {" ": "space"}.get(key, key), names.partition("|")[0].lower())
        for key, names in keys
    ]
    return Markup('<p class="dim">Keys: {}</p>').format(Markup(", ").join(parts))


def spectrum_chart(
    frequencies: Sequence[float] | np.ndarray,
    peaks: Sequence[float] | np.ndarray,
    nyquist: float,
    unit: str,
    band: Band = None,
    labels: Sequence[str] = (),
) -> Markup:
    """Draw stems over 0 … `nyquist` Hz, those in the band coloured, and the band shaded.

    A click presses the button named by the label of the nearest stem with one ("": none).
    """
    frequencies, peaks = np.asarray(frequencies, float), np.asarray(peaks, float)
    top = (float(peaks.max()) if len(peaks) else 0.0) * 1.08 or 1.0
    low, high = (0.0, nyquist) if band is None else band
    parts = [_axes((0.0, nyquist), (0.0, top), "frequency (Hz)", f"peak ({unit})")]
    if band is not None:
        x, right = _x(low, 0, nyquist), _x(high, 0, nyquist)
        parts.append(
            Markup('<rect class="band" x="{:.1f}" y="{}" width="{:.1f}" height="{}"/>').format(
                x, TOP, max(right - x, 1), HEIGHT - TOP - BOTTOM
            )
        )
    for f, peak in zip(frequencies, peaks, strict=True):
        style = "stem in" if low <= f <= high else "stem"
        x = _x(f, 0, nyquist)
        parts.append(_line(x, _y(0, 0, top), x, min(_y(peak, 0, top), _y(0, 0, top) - 1), style))
    parts += _hits(frequencies, peaks, labels, nyquist, unit)
    read = _read(frequencies, peaks, (0.0, nyquist), unit)
    return _svg(parts, f"spectrum: peak displacement ({unit}) over frequency (Hz)", read)


def waveform_chart(
    times: np.ndarray, values: np.ndarray, unit: str, deviation: np.ndarray | None = None
) -> Markup:
    """Draw values [F] over times [F] in seconds, with a band of one standard deviation [F] on either side."""
    spread = np.zeros_like(values) if deviation is None else deviation
    low, high = float((values - spread).min()), float((values + spread).max())
    margin = 0.08 * (high - low) or 1.0
    limits = low - margin, high + margin
    span = float(times[0]), float(times[-1])
    parts = [_axes(span, limits, "time (s)", unit)]
    if deviation is not None:
        around = np.append(times, times[::-1]), np.append(values + spread, (values - spread)[::-1])
        parts.append(_curve("polygon", "spread", *around, span, limits))
    parts.append(_curve("polyline", "curve", times, values, span, limits))
    return _svg(parts, f"waveform: displacement ({unit}) over time (s)")


def density_chart(
    frequencies: np.ndarray,
    amplitudes: np.ndarray,
    floor: np.ndarray,
    unit: str,
    named: Sequence[tuple[float, str]] = (),
) -> Markup:
    """Draw a spectrum [B] over frequencies [B] in Hz with its noise floor [B] dashed.

    A click presses the button of the nearest `named` frequency (Hz).
    """
    top = float(max(amplitudes.max(), floor.max())) * 1.08 or 1.0
    span = 0.0, float(frequencies[-1])
    parts = [_axes(span, (0.0, top), "frequency (Hz)", unit)]
    for style, values in (("floor", floor), ("curve", amplitudes)):
        parts.append(_curve("polyline", style, frequencies, values, span, (0, top)))
    if named:
        hz, labels = np.array([f for f, _ in named]), [name for _, name in named]
        parts += _hits(hz, np.interp(hz, frequencies, amplitudes), labels, span[1], unit)
    read = _read(frequencies, amplitudes, span, unit)
    return _svg(parts, f"spectrum of the waveform ({unit}) over frequency (Hz), its noise floor dashed", read)


def composite_chart(found: LookSummary) -> Markup:
    """Draw a flat capture's power over noise, mean over all cells, in decibels, and the level of noise dashed."""
    power = np.maximum(found.composite[1:], 1.0)
    floor = np.full(len(power), found.composite_floor)
    return density_chart(found.hz[1:], 10 * np.log10(power), 10 * np.log10(floor), "dB over noise")


def _hits(
    frequencies: np.ndarray, peaks: np.ndarray, labels: Sequence[str], nyquist: float, unit: str
) -> list[Markup]:
    """Return transparent areas around the stems with a label, up to half-way to the next."""
    named = [i for i in np.argsort(frequencies, kind="stable") if i < len(labels) and labels[i]]
    if not named:
        return []
    middles = [(frequencies[a] + frequencies[b]) / 2 for a, b in pairwise(named)]
    edges = [0.0, *middles, nyquist]
    parts = []
    for i, low, high in zip(named, edges[:-1], edges[1:], strict=True):
        x = _x(low, 0, nyquist)
        tip = f"{labels[i]}: {number(float(peaks[i]))} {unit}"
        parts.append(
            Markup(
                '<rect class="hit" data-peak="{}" x="{:.1f}" y="{}" width="{:.1f}" height="{}">'
                "<title>{}</title></rect>"
            ).format(labels[i], x, TOP, _x(high, 0, nyquist) - x, HEIGHT - TOP - BOTTOM, tip)
        )
    return parts


def _x(value: float, low: float, high: float) -> float:
    return LEFT + (value - low) / ((high - low) or 1.0) * (WIDTH - LEFT - RIGHT)


def _y(value: float, low: float, high: float) -> float:
    return HEIGHT - BOTTOM - (value - low) / ((high - low) or 1.0) * (HEIGHT - TOP - BOTTOM)


def _curve(
    element: str,
    style: str,
    x: np.ndarray,
    y: np.ndarray,
    span: tuple[float, float],
    limits: tuple[float, float],
) -> Markup:
    points = " ".join(f"{_x(a, *span):.1f},{_y(b, *limits):.1f}" for a, b in zip(x, y, strict=True))
    return Markup('<{} class="{}" points="{}"/>').format(element, style, points)


def _axes(x: tuple[float, float], y: tuple[float, float], x_label: str, y_label: str) -> Markup:
    parts = []
    for tick in nice_ticks(*y, about=5):
        at = _y(tick, *y)
        parts += [
            _line(LEFT, at, WIDTH - RIGHT, at, "line-rule"),
            _text(LEFT - 6, at + 4, number(tick), "end"),
        ]
    for tick in nice_ticks(*x, about=6):
        parts.append(_text(_x(tick, *x), HEIGHT - BOTTOM + 14, number(tick), "middle"))
    parts.append(_text((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 6, x_label, "middle"))
    turned = Markup('<text text-anchor="middle" transform="translate(9 {:.0f}) rotate(-90)">{}</text>')
    parts.append(turned.format((TOP + HEIGHT - BOTTOM) / 2, y_label))
    return Markup("").join(parts)


def _line(x1: float, y1: float, x2: float, y2: float, style: str) -> Markup:
    return Markup('<line class="{}" x1="{:.1f}" y1="{:.1f}" x2="{:.1f}" y2="{:.1f}"/>').format(
        style, x1, y1, x2, y2
    )


def _text(x: float, y: float, text: str, anchor: str) -> Markup:
    return Markup('<text x="{:.1f}" y="{:.1f}" text-anchor="{}">{}</text>').format(x, y, anchor, text)


def _svg(parts: Sequence[Markup], label: str, read: Markup = _NOTHING) -> Markup:
    return Markup('<svg viewBox="0 0 {} {}" role="img" aria-label="{}"{}>{}</svg>').format(
        WIDTH, HEIGHT, label, read, Markup("").join(parts)
    )


def _read(hz: np.ndarray, sizes: np.ndarray, span: tuple[float, float], unit: str) -> Markup:
    """Return attributes for the pointer: the span in Hz, the curve's points, and their unit."""
    points = [[float(f"{v:.4g}") for v in values] for values in (hz, sizes)]
    text = ' data-span="{:.6g} {:.6g}" data-points="{}" data-unit="{}"'
    return Markup(text).format(
        *span, json.dumps(points, separators=(",", ":")), unit.removeprefix("peak (").rstrip(")")
    )
