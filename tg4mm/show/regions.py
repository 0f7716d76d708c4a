"""Drawings of a look at a flat capture: the composite spectrum, the regions of each vibration, and their labels."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from tg4mm.capture.look import LookSummary
from tg4mm.core.pages.charts import CEILING, MUTED, OURS, chart
from tg4mm.core.pages.page import Figure, drawing

_LETTER = 1 / 26  # of the shorter side: the height of a letter
_GAP = 4  # pixels between labels, and to the picture's edge
_TURNS, _RINGS = 16, 40  # positions that are tried around a point, at growing distances
_EDGE = 720  # pixels of the longer side, about
_TINT = 0.45
_LABEL = 0.12  # of the axis: the width of a label
_STRIPES = 6  # pixels apart
REGIONS_ALT = "regions of the vibrations, and independent motion"
COLOURS = ((217, 72, 15), (25, 113, 194), (47, 158, 68), (156, 54, 181), (230, 119, 0))


def write_labels(picture: Image.Image, labels: Sequence[tuple[str, tuple[float, float]]]) -> None:
    """Write texts beside their points (x, y) in pixels, in white with a black edge, on an RGB picture.

    A label that would cover another one is moved away, with a line to its point.
    """
    draw, size = ImageDraw.Draw(picture), max(12, round(_LETTER * min(picture.size)))
    font, taken = ImageFont.load_default(size), list[_Box]()
    for text, point in labels:
        _, _, width, height = draw.textbbox((0, 0), text, font=font)
        box = _free((width, height), point, picture.size, taken, size)
        taken.append(box)
        middle = ((box[0] + box[2]) / 2, (box[1] + box[3]) / 2)
        if np.hypot(middle[0] - point[0], middle[1] - point[1]) > width / 2 + 2 * size:
            draw.line([point, middle], fill=(255, 255, 255), width=2)
        draw.text(box[:2], text, font=font, fill=(255, 255, 255), stroke_width=2, stroke_fill=(0, 0, 0))


_Box = tuple[float, float, float, float]  # left, upper, right, lower


def _free(
    size: tuple[float, float],
    point: tuple[float, float],
    picture: tuple[int, int],
    taken: Sequence[_Box],
    step: float,
) -> _Box:
    """Return the nearest free box, or the one at the point if none is free."""

    def at(x: float, y: float) -> _Box:
        left = min(max(x + _GAP, _GAP), max(picture[0] - size[0] - _GAP, _GAP))
        upper = min(max(y + _GAP, _GAP), max(picture[1] - size[1] - _GAP, _GAP))
        return left, upper, left + size[0], upper + size[1]

    for ring in range(_RINGS):
        for turn in range(_TURNS if ring else 1):
            angle = 2 * np.pi * turn / _TURNS
            box = at(point[0] + ring * step * np.cos(angle), point[1] + ring * step * np.sin(angle))
            if not any(_overlap(box, other) for other in taken):
                return box
    return at(*point)


def _overlap(a: _Box, b: _Box) -> bool:
    return a[0] < b[2] + _GAP and b[0] < a[2] + _GAP and a[1] < b[3] + _GAP and b[1] < a[3] + _GAP


def composite(axes: Any, found: LookSummary) -> None:
    """Draw power over noise (mean over cells), the floor that noise exceeds once in 100 recordings, and the lines."""
    axes.semilogy(found.hz[1:], np.maximum(found.composite[1:], 0.3), color=OURS, lw=1.2)
    axes.axhline(found.composite_floor, color=CEILING, lw=1, ls=(0, (4, 3)))
    taken: list[float] = []
    for n, line in enumerate(found.vibrations):
        k = int(np.argmin(np.abs(found.hz - line.hz)))
        top = max(found.composite[max(k - 1, 0) : k + 2].max(), 1.0)
        colour = tuple(c / 255 for c in COLOURS[n % len(COLOURS)])
        axes.plot([line.hz], [top], "o", color=colour, ms=4)
        higher = sum(abs(line.hz - other) < _LABEL * found.hz[-1] for other in taken)
        taken.append(line.hz)
        side = "right" if line.hz > (1 - _LABEL / 2) * found.hz[-1] else "center"
        offset = {"xytext": (0, 6 + 12 * higher), "textcoords": "offset points"}
        axes.annotate(f"{line.hz:.4g} Hz", (line.hz, top), ha=side, **offset)
    for tone in found.light:
        axes.axvline(tone.hz, color=MUTED, lw=0.8, ls=":")
        style = {"xycoords": ("data", "axes fraction"), "va": "top", "rotation": 90, "color": MUTED}
        axes.annotate("light", (tone.hz, 0.98), **style)
    axes.set(xlabel="frequency, Hz", ylabel="power / noise, mean of all cells", xlim=(0, found.hz[-1]))
    axes.set_ylim(0.3, 3 * max(float(found.composite[1:].max(initial=1.0)), found.composite_floor))


def composite_figure(found: LookSummary) -> Figure:
    """Return the composite spectrum as a figure of a page."""
    drawn = chart(partial(composite, found=found), "composite spectrum over all cells", (6.6, 3.0), True)
    caption = (
        "Composite spectrum: power over noise, mean over all cells; 1 where nothing vibrates. Dashed: the level that "
        "noise alone exceeds anywhere in one recording of a hundred. Dotted: lines of the light."
    )
    return Figure([drawing(drawn)], caption, width="narrow")


def region_picture(found: LookSummary, picture: np.ndarray) -> np.ndarray:
    """Draw the picture [H, W, 3] uint8 in grey, cells that show a line in its colour, independent motion striped."""
    width, height = found.size
    scale = max(1, round(_EDGE / max(width, height)))
    grey = Image.fromarray(picture).convert("L").convert("RGB").resize((width * scale, height * scale))
    shown, cell = np.asarray(grey).astype(float), found.cell_px * scale
    for k, line in reversed(list(enumerate(found.vibrations))):
        cells = np.kron(line.cells, np.ones((cell, cell), bool))
        part = shown[: cells.shape[0], : cells.shape[1]]
        part[cells] = (1 - _TINT) * part[cells] + _TINT * np.array(COLOURS[k % len(COLOURS)])
    moving = np.kron(found.moves_by_itself, np.ones((cell, cell), bool))
    rows, columns = np.indices(moving.shape)
    shown[: moving.shape[0], : moving.shape[1]][moving & ((rows + columns) // _STRIPES % 2 == 0)] = 20
    out = Image.fromarray(shown.astype(np.uint8))
    draw = ImageDraw.Draw(out)
    for k, line in enumerate(found.vibrations):
        x, y = (c * scale for c in line.centre_px)
        u, v = (0.05 * min(out.size) * d for d in line.direction)
        draw.line([(x - u, y - v), (x + u, y + v)], fill=COLOURS[k % len(COLOURS)], width=max(2, scale))
    centres = [(line.centre_px[0] * scale, line.centre_px[1] * scale) for line in found.vibrations]
    write_labels(out, [(f"{v.hz:.4g} Hz", at) for v, at in zip(found.vibrations, centres, strict=True)])
    for mover in found.movers:
        left, upper, right, lower = (c * scale for c in mover.box)
        box = left, upper, min(right, out.width) - 1, min(lower, out.height) - 1
        draw.rectangle(box, outline=(255, 255, 255), width=max(1, scale // 2))
    return np.asarray(out)
