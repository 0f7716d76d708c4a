"""The panel's pictures as pure functions: spectrum with band, displacement over time, legends of the colours."""

import math
import tempfile
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import blf
import imbuf
import numpy as np

from tg4mm.core.colour import to_display

from ..nodes import blending, colours
from ..units import Unit

Colour = tuple[float, float, float]  # display-referred sRGB, 0 to 1
Rows = tuple[Colour, ...]  # of a colour map, as they look on the screen; hashable
SIDE = 400
_TEXT = 17.0  # height of capitals
_CAPITAL = 0.73  # of a font's size
_LARGE_TEXT = 23.0  # of the spectrum, which is shown smaller than the others
_BACK: Colour = (0.11, 0.11, 0.115)
_FRONT: Colour = (0.86, 0.86, 0.86)
_FAINT: Colour = (0.32, 0.32, 0.33)
_BAND: Colour = (0.28, 0.45, 0.70)
_INSIDE: Colour = (1.0, 0.63, 0.22)
_OUTSIDE: Colour = (0.55, 0.55, 0.56)
_AXES: tuple[Colour, ...] = ((0.94, 0.33, 0.36), (0.52, 0.80, 0.25), (0.36, 0.62, 0.98))  # Blender's x, y, z
_LEFT, _RIGHT, _TOP, _BOTTOM = 14.0, 386.0, 92.0, 312.0  # of the plot's area


def standard_rows(linear: np.ndarray) -> Rows:
    """Convert linear colours [K, 3] to those displayed under the view transform Standard."""
    return tuple((float(r), float(g), float(b)) for r, g, b in to_display(linear))


STANDARD_AMPLITUDE, STANDARD_PHASE = map(standard_rows, (colours.amplitude_map(), colours.phase_and_still()))


def spectrum(
    freqs_hz: Sequence[float],
    amplitudes: Sequence[float],
    band: tuple[float, float],
    highest_hz: float,
    title: str,
    unit: Unit,
) -> np.ndarray:
    """Draw a bar per mode, amplitude (scene units) over frequency from 0 to `highest_hz`, with the band shaded."""
    canvas = Canvas(SIDE, SIDE, _BACK)
    most = max(amplitudes, default=0.0)
    ceiling = most if most > 0 else 1.0

    def place(f: float) -> float:
        return _LEFT + (_RIGHT - _LEFT) * min(max(f / highest_hz, 0.0), 1.0)

    canvas.box(place(band[0]), _TOP, place(band[1]), _BOTTOM, _BAND, 0.45)
    for edge in band:
        if 0 < edge < highest_hz:
            canvas.box(place(edge) - 1, _TOP, place(edge) + 1, _BOTTOM, _BAND)
    _frame(canvas)
    slack = 1e-6 * max(1.0, highest_hz)
    half = min(7.0, max(2.0, 0.3 * (_RIGHT - _LEFT) / max(len(freqs_hz), 1)))
    for f, a in zip(freqs_hz, amplitudes, strict=True):
        inside = band[0] - slack <= f <= band[1] + slack
        top = _BOTTOM - (_BOTTOM - _TOP) * 0.94 * a / ceiling
        canvas.box(place(f) - half, top, place(f) + half, _BOTTOM, _INSIDE if inside else _OUTSIDE)
    canvas.text(_LEFT, 36, f"{title}, {unit.name}", _FRONT, _LARGE_TEXT)
    canvas.text(_LEFT, 76, f"peak {most * unit.per_scene_unit:.2g}", _INSIDE, _LARGE_TEXT)
    _ticks(canvas, 0.0, highest_hz, "Frequency, Hz", _LARGE_TEXT, most=3)
    return canvas.pixels


def series(seconds: np.ndarray, moved: np.ndarray, unit: Unit) -> np.ndarray:
    """Plot displacements [S, 3] (scene units) along x, y, z over times [S] in seconds."""
    canvas = Canvas(SIDE, SIDE, _BACK)
    most = float(np.abs(moved).max(initial=0.0))
    middle, height = (_TOP + _BOTTOM) / 2, (_BOTTOM - _TOP) / 2 * 0.94
    last = max(float(seconds[-1]), 1e-9)
    canvas.box(_LEFT, middle - 0.75, _RIGHT, middle + 0.75, _FAINT)
    _frame(canvas)
    x = _LEFT + (_RIGHT - _LEFT) * seconds / last
    for axis, colour in enumerate(_AXES):
        y = middle - height * moved[:, axis] / (most or 1.0)
        canvas.line(np.column_stack([x, y]), colour, 3.0)
    canvas.text(_LEFT, 32, f"Displacement, {unit.name}", _FRONT, _TEXT)
    canvas.text(_LEFT, 66, f"max {unit.number(most)}", _FRONT, _TEXT)
    for axis, colour in enumerate(_AXES):
        canvas.text(_RIGHT - 90 + 36 * axis, 66, "xyz"[axis], colour, _TEXT)
    _ticks(canvas, 0.0, last, "Time, s", _TEXT)
    return canvas.pixels


def mark_time(picture: np.ndarray, part: float) -> np.ndarray:
    """Return a copy of a picture of `series` with a line at `part` (0 to 1) of its time, if inside."""
    canvas = Canvas(1, 1, _BACK)
    canvas.pixels = picture.copy()
    if 0 <= part <= 1:
        x = _LEFT + (_RIGHT - _LEFT) * part
        canvas.box(x - 1.5, _TOP, x + 1.5, _BOTTOM, _FRONT, 0.9)
    return canvas.pixels


def amplitude_legend(highest: float, unit: Unit, rows: Rows = STANDARD_AMPLITUDE) -> np.ndarray:
    """Draw the colour bar of `rows` from 0 to `highest`, scene units, with numbers."""
    canvas = Canvas(SIDE, SIDE, _BACK)
    canvas.text(_LEFT, 32, "Amplitude in the band,", _FRONT, _TEXT)
    canvas.text(_LEFT, 64, unit.name, _FRONT, _TEXT)
    top, bottom, left, right = 100, 376, 24, 110
    at = 1.0 - (np.arange(bottom - top) + 0.5) / (bottom - top)
    column = _between(at, rows)
    bar = np.repeat(column[:, None], right - left, axis=1)
    canvas.paste(bar, np.ones(bar.shape[:2]), left, top)
    shown = highest * unit.per_scene_unit
    values = [v for v in ticks(0.0, shown, 5) if v < 0.93 * shown]
    for value in [*values, shown]:
        y = bottom - (bottom - top) * (value / shown if shown > 0 else 0.0)
        canvas.box(right, y - 1, right + 10, y + 1, _FRONT)
        label = f"{value:.{unit.digits}g}" if value == shown else f"{value:g}"
        canvas.text(right + 20, y + _TEXT / 2, label, _FRONT, _TEXT)
    return canvas.pixels


def phase_legend(still_below: float, unit: Unit, rows: Rows = STANDARD_PHASE) -> np.ndarray:
    """Draw the phase wheel, 0° on the right and counter-clockwise, and grey for less than `still_below`.

    `rows`: the colours of the turn, then the grey.
    """
    canvas = Canvas(SIDE, SIDE, _BACK)
    canvas.text(_LEFT, 32, "Phase of the largest", _FRONT, _TEXT)
    canvas.text(_LEFT, 64, "frequency in the band", _FRONT, _TEXT)
    side, centre_x, centre_y = 200, 200, 204
    y, x = np.mgrid[:side, :side] + 0.5 - side / 2
    turn = (np.arctan2(-y, x) / (2 * np.pi)) % 1.0
    wheel = _between(turn, rows[:-1])
    radius = np.hypot(x, y)
    ring = np.clip(side / 2 - radius, 0, 1) * np.clip(radius - side / 4, 0, 1)
    canvas.paste(wheel, ring, centre_x - side // 2, centre_y - side // 2)
    half = _TEXT / 2
    for words, dx, dy, anchor in (
        ("0°", 112, half, 0.0),
        ("90°", 0, -110, 0.5),
        ("180°", -112, half, 1.0),
        ("270°", 0, 110 + _TEXT, 0.5),
    ):
        canvas.text(centre_x + dx, centre_y + dy, words, _FRONT, _TEXT, anchor)
    canvas.box(_LEFT, 362, _LEFT + 26, 388, rows[-1])
    canvas.text(_LEFT + 38, 386, f"< {unit.text(still_below)}", _FRONT, _TEXT)
    return canvas.pixels


def _between(parts: np.ndarray, rows: Rows) -> np.ndarray:
    """Interpolate the colours [..., 3] of a map at `parts` (0 to 1) of its length."""
    table = np.array(rows)
    return np.stack([np.interp(parts, np.linspace(0, 1, len(table)), table[:, c]) for c in range(3)], axis=-1)


def ticks(low: float, high: float, most: int) -> list[float]:
    """Return at most `most` + 1 round numbers from low to high, in steps of 1, 2 or 5 times a power of ten."""
    span = high - low
    if not span > 0 or not math.isfinite(span):
        return [low]
    power = 10.0 ** math.floor(math.log10(span / most))
    step = next(power * m for m in (1, 2, 5, 10, 20) if span / (power * m) <= most)
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [float(f"{i * step:.12g}") for i in range(first, last + 1)]


def _frame(canvas: "Canvas") -> None:
    canvas.box(_LEFT, _BOTTOM, _RIGHT, _BOTTOM + 2, _FRONT, 0.7)


def _ticks(canvas: "Canvas", low: float, high: float, title: str, size: float, most: int = 5) -> None:
    for value in ticks(low, high, most):
        part = (value - low) / (high - low)
        x = _LEFT + (_RIGHT - _LEFT) * part
        canvas.box(x - 1, _BOTTOM, x + 1, _BOTTOM + 8, _FRONT, 0.7)
        # The first and last number stay inside the picture.
        anchor = 0.0 if part < 0.03 else 1.0 if part > 0.97 else 0.5
        canvas.text(x, _BOTTOM + 17 + size, f"{value:g}", _FRONT, size, anchor)
    canvas.text((_LEFT + _RIGHT) / 2, SIDE - 12, title, _FRONT, size, 0.5)


class Canvas:
    """An opaque picture [height, width, 4], float32, row 0 at the top. Positions are x right, y down, in pixels."""

    def __init__(self, width: int, height: int, background: Colour) -> None:
        self.pixels = np.ones((height, width, 4), np.float32)
        self.pixels[..., :3] = background

    def box(self, x0: float, y0: float, x1: float, y1: float, colour: Colour, alpha: float = 1.0) -> None:
        """Fill a rectangle with antialiased edges."""
        left, top = math.floor(x0), math.floor(y0)
        across = _overlap(x0 - left, x1 - left, max(math.ceil(x1) - left, 0))
        down = _overlap(y0 - top, y1 - top, max(math.ceil(y1) - top, 0))
        self._paint(down[:, None] * across[None], left, top, colour, alpha)

    def line(self, points: np.ndarray, colour: Colour, thickness: float = 2.0, alpha: float = 1.0) -> None:
        """Draw a line with round ends through points [K, 2]."""
        cover, x, y = _stroke(np.asarray(points, float), thickness)
        self._paint(cover, x, y, colour, alpha)

    def text(self, x: float, y: float, words: str, colour: Colour, size: float, anchor: float = 0.0) -> None:
        """Draw text with its baseline at y, capitals `size` high; `anchor` is the fraction left of x."""
        cover, rise = _words(words, size)
        self._paint(cover, round(x - anchor * cover.shape[1]), round(y) - rise, colour, 1.0)

    def paste(self, rgb: np.ndarray, cover: np.ndarray, x: int, y: int) -> None:
        """Blend in colours [h, w, 3] with coverage [h, w]."""
        self._paint(cover, x, y, rgb, 1.0)

    def _paint(self, cover: np.ndarray, x: int, y: int, colour: Colour | np.ndarray, alpha: float) -> None:
        height, width = self.pixels.shape[:2]
        top, left = max(0, -y), max(0, -x)
        bottom, right = min(cover.shape[0], height - y), min(cover.shape[1], width - x)
        if bottom <= top or right <= left:
            return
        part = (slice(top, bottom), slice(left, right))
        paint = colour[part] if isinstance(colour, np.ndarray) else np.asarray(colour)
        below = self.pixels[y + top : y + bottom, x + left : x + right, :3]
        below += (alpha * cover[part])[..., None] * (paint - below)


@lru_cache(maxsize=512)
def _words(words: str, size: float) -> tuple[np.ndarray, int]:
    """Return the coverage of text in Blender's font, capitals `size` high, and its rows above the baseline."""
    blf.size(0, size / _CAPITAL)
    width, rise, drop = (
        math.ceil(blf.dimensions(0, words)[0]) + 2,
        math.ceil(1.5 * size),
        math.ceil(0.5 * size),
    )
    drawn = imbuf.new((max(width, 1), rise + drop))
    with blf.bind_imbuf(0, drawn), tempfile.TemporaryDirectory() as folder:
        blf.color(0, 1.0, 1.0, 1.0, 1.0)
        blf.position(0, 1, drop, 0)
        blf.draw_buffer(0, words)
        file = Path(folder) / "words.png"  # the only way to its pixels in 4.5
        imbuf.write(drawn, filepath=str(file))
        cover = blending.pixels(file.read_bytes())[..., 0]
    inked = np.flatnonzero(cover.any(axis=0))
    return cover[:, inked[0] : inked[-1] + 1] if len(inked) else cover, rise


def _stroke(points: np.ndarray, thickness: float) -> tuple[np.ndarray, int, int]:
    reach = thickness / 2 + 1
    low = np.floor(points.min(axis=0) - reach).astype(int)
    high = np.ceil(points.max(axis=0) + reach).astype(int)
    cover = np.zeros((high[1] - low[1], high[0] - low[0]))
    for a, b in pairwise(points if len(points) > 1 else np.repeat(points, 2, axis=0)):
        first = np.floor(np.minimum(a, b) - reach).astype(int) - low
        last = np.ceil(np.maximum(a, b) + reach).astype(int) - low
        x = np.arange(first[0], last[0]) + low[0] + 0.5
        y = np.arange(first[1], last[1])[:, None] + low[1] + 0.5
        along, length = b - a, float(((b - a) ** 2).sum())
        part = ((x - a[0]) * along[0] + (y - a[1]) * along[1]) / max(length, 1e-12)
        part = np.clip(part, 0.0, 1.0)
        distance = np.hypot(x - a[0] - part * along[0], y - a[1] - part * along[1])
        here = cover[first[1] : last[1], first[0] : last[0]]
        np.maximum(here, np.clip(thickness / 2 + 0.5 - distance, 0.0, 1.0), out=here)
    return cover, int(low[0]), int(low[1])


def _overlap(start: float, stop: float, count: int) -> np.ndarray:
    """Return the fraction [count] of each pixel that start … stop covers."""
    pixels = np.arange(count)
    return np.clip(np.minimum(pixels + 1, stop) - np.maximum(pixels, start), 0.0, 1.0)
