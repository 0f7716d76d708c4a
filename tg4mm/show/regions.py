"""Drawings of a look at a flat capture: the composite spectrum, and the regions of each vibration."""

from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from tg4mm.capture.look import Found
from tg4mm.core.pages.charts import CEILING, MUTED, OURS
from tg4mm.show.labels import write_labels

_EDGE = 720  # pixels of the longer side, about
_TINT = 0.45
_LABEL = 0.12  # of the axis: the width of a label
_STRIPES = 6  # pixels apart
COLOURS = ((217, 72, 15), (25, 113, 194), (47, 158, 68), (156, 54, 181), (230, 119, 0))


def composite(axes: Any, found: Found) -> None:
    """Mean over cells of power over noise, the floor that noise exceeds once in a hundred recordings, and the lines."""
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
        axes.annotate(
            f"{line.hz:.4g} Hz",
            (line.hz, top),
            ha="right" if line.hz > (1 - _LABEL / 2) * found.hz[-1] else "center",
            xytext=(0, 6 + 12 * higher),
            textcoords="offset points",
        )
    for tone in found.light:
        axes.axvline(tone.hz, color=MUTED, lw=0.8, ls=":")
        axes.annotate(
            "light", (tone.hz, 0.98), xycoords=("data", "axes fraction"), va="top", rotation=90, color=MUTED
        )
    axes.set(xlabel="frequency, Hz", ylabel="power / noise, mean of all cells", xlim=(0, found.hz[-1]))
    axes.set_ylim(0.3, 3 * max(float(found.composite[1:].max(initial=1.0)), found.composite_floor))


def region_picture(found: Found, picture: np.ndarray) -> np.ndarray:
    """The picture [H, W, 3] uint8 in grey, cells that show a line in its colour, what moves by itself striped."""
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
        draw.rectangle(
            (left, upper, min(right, out.width) - 1, min(lower, out.height) - 1),
            outline=(255, 255, 255),
            width=max(1, scale // 2),
        )
    return np.asarray(out)
