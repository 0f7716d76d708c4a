"""Pictures for the report: the contact sheet, and maps of displacement laid over what the camera sees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from tg4mm.core.colour import amount_colours

from .dataset import Dataset, View, evenly, read_picture
from .pixels import project

_INK, _MUTED, _PAPER = (27, 29, 33), (103, 107, 115), (255, 255, 255)
_MARK = (20, 120, 230)
_GAP, _LABEL = 6, 20  # pixels


@dataclass(frozen=True)
class Cell:
    """One picture of a sheet."""

    image: np.ndarray | None  # [H, W, 3] in 0..1, None if the file is absent
    label: str


def sheet(rows: Sequence[tuple[str, Sequence[Cell]]], edge: int = 168) -> Image.Image:
    """Rows of labelled pictures, each at most `edge` pixels, under a heading each; on white."""
    font, bold = (ImageFont.load_default(size) for size in (12, 14))
    widest = max(len(cells) for _, cells in rows)
    shapes = [c.image.shape for _, cells in rows for c in cells if c.image is not None]
    aspect = max((h / w for h, w, _ in shapes), default=1.0)
    width, height = (edge, round(edge * aspect)) if aspect <= 1 else (round(edge / aspect), edge)
    pitch = height + _LABEL + _GAP
    headings = sum(1 for heading, _ in rows if heading)
    total = (widest * (width + _GAP) + _GAP, len(rows) * pitch + headings * 26 + _GAP)
    made = Image.new("RGB", total, _PAPER)
    draw = ImageDraw.Draw(made)
    y = _GAP
    for heading, cells in rows:
        if heading:
            draw.text((_GAP, y + 4), heading, _INK, bold)
            y += 26
        for i, cell in enumerate(cells):
            x = _GAP + i * (width + _GAP)
            if cell.image is None:
                draw.rectangle((x, y, x + width - 1, y + height - 1), outline=_MUTED)
                draw.text((x + 8, y + height // 2 - 8), "absent", _MUTED, font)
            else:
                made.paste(resized(cell.image, width, height), (x, y))
            draw.text((x + 1, y + height + 2), cell.label, _MUTED, font)
        y += pitch
    return made


def resized(image: np.ndarray, width: int, height: int) -> Image.Image:
    """A float picture [H, W, 3] as an image of this size."""
    pixels = Image.fromarray((np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8))
    return pixels.resize((width, height), Image.Resampling.LANCZOS)


def contact_rows(dataset: Dataset, n_test: int = 3, n_train: int = 18) -> list[tuple[str, list[Cell]]]:
    """Test cameras at rest, at two timesteps, and at every α; then training cameras at timestep 0."""
    rows: list[tuple[str, list[Cell]]] = []
    times = sheet_timesteps(dataset)
    strongest = dataset.timesteps_by_strength()[0]
    for name, views in evenly(list(dataset.by_camera("test").items()), n_test):
        at = {view.timestep: view for view in views}
        cells = [Cell(_maybe(at[t].image), f"t = {t}") for t in times if t in at]
        if strongest in at:
            view = at[strongest]
            cells += [
                Cell(_maybe(dataset.magnified(view, a)), f"alpha = {a:g}, t = {strongest}")
                for a in dataset.alphas
            ]
        rows.append((f"test {name}: as captured, then the ground truth magnified", cells))
    across = max([len(cells) for _, cells in rows], default=6)
    every = dataset.at("train", 0)
    full = min(n_train, len(every)) // across * across  # whole rows
    first = evenly(every, full or len(every))
    for i in range(0, len(first), across):
        heading = "" if i else f"training cameras at timestep 0 ({len(first)} of {len(every)})"
        rows.append((heading, [Cell(_maybe(v.image), v.name) for v in first[i : i + across]]))
    return rows


def sheet_timesteps(dataset: Dataset) -> list[int]:
    """Timestep 0, the one farthest from rest, and the one farthest from that, in order of time."""
    first = dataset.timesteps_by_strength()[0]
    if dataset.motion is None:
        return sorted({0, first, dataset.n_timesteps // 2})
    away = np.abs(dataset.motion.gains - dataset.motion.gains[first]).sum(axis=1)
    return sorted({0, first, int(np.argmax(away.round(6)))})


def _maybe(path: Path) -> np.ndarray | None:
    return read_picture(path) if path.is_file() else None


def enlarged(image: np.ndarray, edge: int = 384) -> np.ndarray:
    """A small picture [H, W, C] repeated pixel by pixel to about `edge`; larger ones as they are."""
    factor = max(1, edge // max(image.shape[:2]))
    return np.repeat(np.repeat(image, factor, 0), factor, 1)


def overlay(image: np.ndarray, amounts: np.ndarray, top: float) -> np.ndarray:
    """Amounts [H, W] (NaN: nothing there) in colours over the picture in pale grey; [H, W, 3] in 0..1.

    What does not move keeps the grey; colours fade in over the first hundredth of `top`.
    """
    grey = 0.35 * (image @ np.array([0.2126, 0.7152, 0.0722]))[..., None] + 0.6
    share = np.nan_to_num(amounts, nan=0.0) / top if top > 0 else np.zeros(amounts.shape)
    weight = np.clip(share / 0.01, 0.0, 1.0)[..., None]
    weight[np.isnan(amounts)] = 0.0
    return np.clip((1 - weight) * grey + weight * amount_colours(share), 0.0, 1.0)


def dotted(image: np.ndarray, view: View, points: np.ndarray, amounts: np.ndarray, top: float) -> np.ndarray:
    """As `overlay`, of surface points [N, 3] drawn as dots, the nearest last; hidden ones are drawn too."""
    grey = 0.35 * (image @ np.array([0.2126, 0.7152, 0.0722]))[..., None] + 0.6
    made = np.repeat(grey, 3, -1)
    pixel, depth = project(points, view)
    height, width = image.shape[:2]
    with np.errstate(invalid="ignore"):
        shown = (depth > 0) & (amounts > 0.01 * top) & ((pixel >= 0) & (pixel < (width, height))).all(-1)
    order = np.flatnonzero(shown)
    order = order[np.argsort(amounts[order])]
    column, row = np.floor(pixel[order]).astype(int).T
    made[row, column] = amount_colours(amounts[order] / top)
    return np.clip(made, 0.0, 1.0)


def ringed(image: np.ndarray, pixel: tuple[int, int], factor: int) -> np.ndarray:
    """An enlarged picture with a ring around pixel (row, column) of the original."""
    row, column = pixel
    drawn = Image.fromarray((np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8))
    x, y = (column + 0.5) * factor, (row + 0.5) * factor
    radius = max(5.0, 0.02 * max(drawn.size))
    draw = ImageDraw.Draw(drawn)
    for grow, colour in ((2, _PAPER), (0, _MARK)):
        box = (x - radius - grow, y - radius - grow, x + radius + grow, y + radius + grow)
        draw.ellipse(box, outline=colour, width=3 if grow == 0 else 7)
    return np.asarray(drawn)
