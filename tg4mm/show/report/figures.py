"""Pictures from numbers: contact sheet, marked line, space-time slices, maps of amounts and of phases."""

import math
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from tg4mm.core.colour import STILL, amount_colours, phase_colours, phase_share
from tg4mm.core.pictures.frames import to_bytes
from tg4mm.show.slices import Axis, most_moving_line, space_time_slice

MARK = (217, 72, 15)


@dataclass(frozen=True)
class Line:
    """The pixels of a row or column whose motion a space-time slice shows."""

    axis: Axis
    index: int  # which row or column, pixels
    start: int  # first pixel along it
    stop: int  # one past the last

    def __str__(self) -> str:
        return f"{self.axis} {self.index}, pixels {self.start} to {self.stop - 1}"


def contact_sheet(images: list[np.ndarray], columns: int, gap: int = 4, edge: int = 160) -> np.ndarray:
    """uint8 pictures [H, W, 3] as a grid, each at most `edge` pixels, gaps transparent: [h, w, 4] uint8."""
    if not images:
        raise ValueError("a contact sheet needs at least one picture")
    height, width = images[0].shape[:2]
    scale = edge / max(height, width)
    w, h = max(1, round(width * scale)), max(1, round(height * scale))
    columns = min(columns, len(images))
    rows = math.ceil(len(images) / columns)
    sheet = Image.new("RGBA", (columns * (w + gap) - gap, rows * (h + gap) - gap))
    for i, image in enumerate(images):
        small = Image.fromarray(image).resize((w, h), Image.Resampling.LANCZOS)
        sheet.paste(small, ((i % columns) * (w + gap), (i // columns) * (h + gap)))
    return np.asarray(sheet)


def line_that_moves(video: np.ndarray, axis: Axis | None = None, margin: float = 0.12) -> Line:
    """The line of a video [T, H, W, 3] in 0..1 with most change, cut to where it changes plus a margin.

    axis: that things move along; None: of rows and columns, what changes most.
    """
    axis, index = most_moving_line(video, axis)
    line = video[:, index] if axis == "row" else video[:, :, index]
    change = line.astype(np.float64).var(axis=0).mean(axis=-1)
    length = len(change)
    moving = np.flatnonzero(change > 0.02 * change.max()) if change.max() > 0 else np.arange(length)
    pad = max(4, round(margin * length))
    return Line(axis, index, max(0, int(moving[0]) - pad), min(length, int(moving[-1]) + 1 + pad))


def slice_picture(video: np.ndarray, line: Line, periods: int = 1) -> np.ndarray:
    """The slice of a uint8 video, `periods` times over; time runs right for a column, down for a row."""
    picture = space_time_slice(video, line.axis, line.index)
    if line.axis == "row":
        return np.tile(picture[:, line.start : line.stop], (periods, 1, 1))
    return np.tile(picture[line.start : line.stop], (1, periods, 1))


def marked(image: np.ndarray, line: Line, edge: int = 512) -> np.ndarray:
    """The uint8 picture enlarged to about `edge` pixels with the line drawn on it."""
    height, width = image.shape[:2]
    scale = max(1, round(edge / max(height, width)))
    big = Image.fromarray(image).resize((width * scale, height * scale), Image.Resampling.BICUBIC)
    draw = ImageDraw.Draw(big)
    across, start, stop = (line.index + 0.5) * scale, line.start * scale * 1.0, line.stop * scale - 1.0
    thick = max(2, round(0.006 * max(big.size)))
    tick = 3 * thick
    if line.axis == "row":
        segments = [((start, across), (stop, across))]
        segments += [((end, across - tick), (end, across + tick)) for end in (start, stop)]
    else:
        segments = [((across, start), (across, stop))]
        segments += [((across - tick, end), (across + tick, end)) for end in (start, stop)]
    for segment in segments:
        draw.line(segment, fill=MARK, width=thick)
    return np.asarray(big)


def map_picture(values: np.ndarray, top: float, opacity: np.ndarray | None = None) -> np.ndarray:
    """Amounts [H, W] from 0 to `top` as colours: [H, W, 4] uint8, transparent where `opacity` is 0."""
    colours = amount_colours(values / top if top > 0 else np.zeros_like(values))
    alpha = np.ones(values.shape) if opacity is None else np.clip(opacity, 0, 1)
    return to_bytes(np.concatenate([colours, alpha[..., None]], -1))


def phase_picture(phase: np.ndarray, strength: np.ndarray, opacity: np.ndarray) -> np.ndarray:
    """Phases [H, W] in radians as hues, fading to grey where `strength` (0..1) is small: [H, W, 4] uint8."""
    weight = phase_share(strength)[..., None]
    colours = weight * phase_colours(phase) + (1 - weight) * STILL
    return to_bytes(np.concatenate([colours, np.clip(opacity, 0, 1)[..., None]], -1))
