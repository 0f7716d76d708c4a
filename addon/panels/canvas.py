"""A picture drawn in numpy: boxes, lines and text with smooth edges. Needs no Blender and no graphics card."""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import pairwise

import numpy as np

from . import strokes

Colour = tuple[float, float, float]  # display-referred sRGB, 0 to 1


class Canvas:
    """An opaque picture [height, width, 4] float32, row 0 at the top. Places are x right, y down, pixels."""

    def __init__(self, width: int, height: int, background: Colour) -> None:
        self.pixels = np.ones((height, width, 4), np.float32)
        self.pixels[..., :3] = background

    def box(self, x0: float, y0: float, x1: float, y1: float, colour: Colour, alpha: float = 1.0) -> None:
        """Fill a rectangle; its edges cover pixels in part."""
        left, top = math.floor(x0), math.floor(y0)
        across = _overlap(x0 - left, x1 - left, max(math.ceil(x1) - left, 0))
        down = _overlap(y0 - top, y1 - top, max(math.ceil(y1) - top, 0))
        self._paint(down[:, None] * across[None], left, top, colour, alpha)

    def line(self, points: np.ndarray, colour: Colour, thickness: float = 2.0, alpha: float = 1.0) -> None:
        """A line with round ends through points [K, 2]."""
        cover, x, y = _stroke(np.asarray(points, float), thickness)
        self._paint(cover, x, y, colour, alpha)

    def text(self, x: float, y: float, words: str, colour: Colour, size: float, anchor: float = 0.0) -> None:
        """Words with their baseline at y, capitals `size` high; `anchor`: the part of them left of x."""
        unit = size / (strokes.TOP - strokes.BASE)
        place = float(round(x - anchor * text_width(words, size)))
        for character in words:
            cover, left, top, width = _glyph(character, unit)
            self._paint(cover, round(place) + left, round(y) + top, colour, 1.0)
            place += (width + strokes.GAP) * unit

    def paste(self, rgb: np.ndarray, cover: np.ndarray, x: int, y: int) -> None:
        """Blend colours [h, w, 3] in, covering by [h, w]."""
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


def text_width(words: str, size: float) -> float:
    """Pixels that words take whose capitals are `size` high."""
    widths = sum(strokes.strokes(c)[1] + strokes.GAP for c in words) - strokes.GAP * (len(words) > 0)
    return widths * size / (strokes.TOP - strokes.BASE)


@lru_cache(maxsize=512)
def _glyph(character: str, unit: float) -> tuple[np.ndarray, int, int, int]:
    """Coverage of a character, its left and top from the start of its baseline, its width in strokes' units."""
    lines, width = strokes.strokes(character)
    if not lines:
        return np.zeros((1, 1)), 0, 0, width
    drawn = [_stroke(line * [unit, -unit], max(1.2, 0.85 * unit)) for line in lines]
    left, top = min(x for _, x, _ in drawn), min(y for _, _, y in drawn)
    right = max(x + cover.shape[1] for cover, x, _ in drawn)
    bottom = max(y + cover.shape[0] for cover, _, y in drawn)
    whole = np.zeros((bottom - top, right - left))
    for cover, x, y in drawn:
        part = whole[y - top : y - top + cover.shape[0], x - left : x - left + cover.shape[1]]
        np.maximum(part, cover, out=part)
    return whole, left, top, width


def _stroke(points: np.ndarray, thickness: float) -> tuple[np.ndarray, int, int]:
    """Coverage of a polyline, and where its left upper pixel is."""
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
    """[count] the part of each pixel that start … stop covers."""
    pixels = np.arange(count)
    return np.clip(np.minimum(pixels + 1, stop) - np.maximum(pixels, start), 0.0, 1.0)
