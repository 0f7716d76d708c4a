"""How far things move in the picture, per view and mode; maps of it and the contact sheet."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from tg4mm.core.colour import amount_colours
from tg4mm.core.errors import CaptureError

from ..cameras import camera as pinhole
from ..errors import GenerateError
from .dataset import Dataset, MotionTruth, View, displacement_of, evenly, read_picture

MOVING = 0.01  # of the set's largest displacement: what is displaced by more counts as moving
STILL = 1e-6  # of it: what is displaced by less stands still but for rounding
_MOST_TIMES = 16  # truth files read per view
_MOST_VERTICES = 20000
NOTHING = 1e9  # depth from which on a pixel sees nothing (the file has 1e10 there)


@dataclass(frozen=True)
class ViewMotion:
    """Motion in one view: the peak over time of every pixel (or vertex), summed up over those that move."""

    split: str
    name: str
    source: str  # "truth" (per-pixel files) or "vertices" (projected, hidden ones too)
    maximum: float  # pixels
    p95: float  # pixels
    median: float  # pixels
    still: float  # share of the seen pixels (of the vertices in the picture) that never move
    n: int  # pixels or vertices that move


@dataclass(frozen=True)
class Seen:
    """What the truth says of one view over time; timesteps that share a file are read once."""

    view: View  # at the first of the timesteps
    timesteps: tuple[int, ...]
    fixed: bool  # whether the camera stands still
    displacement: np.ndarray  # [n, H, W, 3] float32, scene units, NaN where nothing is seen
    pixels: np.ndarray  # [n, H, W] float32, projected, NaN where nothing is seen

    @property
    def peak(self) -> np.ndarray:
        """[H, W] largest displacement over time, scene units, NaN where nothing is ever seen."""
        return _nanmax(np.linalg.norm(self.displacement, axis=-1))

    @property
    def peak_pixels(self) -> np.ndarray:
        """[H, W] largest projected displacement over time, NaN where nothing is ever seen."""
        return _nanmax(self.pixels)


def project(points: np.ndarray, view: View) -> tuple[np.ndarray, np.ndarray]:
    """Pixels [..., 2] (NaN behind the camera) and depth [...] of world points [..., 3]."""
    pixels, depth = pinhole.project(points, view.camera_to_world, view.intrinsics)
    return np.where((depth > 1e-9)[..., None], pixels, np.nan), depth


def unproject(depth: np.ndarray, view: View) -> np.ndarray:
    """World points [H, W, 3] that pixel centres see at planar depths [H, W]."""
    return pinhole.unproject(depth, view.camera_to_world, view.intrinsics)


def projected_motion(position: np.ndarray, displacement: np.ndarray, view: View) -> np.ndarray:
    """Pixels [...] between where points are, [..., 3], and where they are at rest."""
    here, _ = project(position, view)
    rest, _ = project(position - displacement, view)
    return np.linalg.norm(here - rest, axis=-1)


def seen_motion(dataset: Dataset, views: list[View], most: int = _MOST_TIMES) -> Seen | None:
    """The truth of one camera's views, strongest timesteps first in choice; None if there is no file."""
    from ..truth import read_exr

    files: dict[tuple[int, int], tuple[View, Path]] = {}
    for view in views:
        path = dataset.truth_file(view)
        if path.is_file():
            stat = path.stat()
            files.setdefault((stat.st_dev, stat.st_ino), (view, path))
    if not files:
        return None
    chosen = sorted(evenly(list(files.values()), most), key=lambda found: found[0].timestep)
    displaced, moved = [], []
    for view, path in chosen:
        try:
            passes = read_exr(path, view.size)
        except CaptureError as error:
            raise GenerateError(str(error)) from None
        sees = passes["Depth"] < NOTHING
        position = unproject(np.where(sees, passes["Depth"], 1.0).astype(np.float64), view)
        displaced.append(np.where(sees[..., None], passes["Displacement"], np.nan))
        moved.append(np.where(sees, projected_motion(position, passes["Displacement"], view), np.nan))
    fixed = all(np.allclose(v.camera_to_world, views[0].camera_to_world, atol=1e-9) for v in views)
    return Seen(
        view=chosen[0][0], timesteps=tuple(view.timestep for view, _ in chosen), fixed=fixed,
        displacement=np.stack(displaced).astype(np.float32), pixels=np.stack(moved).astype(np.float32),
    )  # fmt: skip


def motion_from_truth(seen: Seen, amplitude: float) -> ViewMotion:
    """Motion of a view from its per-pixel truth; `amplitude` is the set's largest displacement."""
    peak = seen.peak
    return _summed_up(seen.view, "truth", peak[~np.isnan(peak)], seen.peak_pixels[~np.isnan(peak)], amplitude)


def motion_from_vertices(motion: MotionTruth, views: list[View], amplitude: float) -> ViewMotion:
    """Motion of one camera's views from the vertices inside the picture, whether hidden or not."""
    largest, pixels = [], []
    stride = max(1, sum(len(body.rest) for body in motion.bodies) // _MOST_VERTICES)
    used = evenly(views, 30)
    for body in motion.bodies:
        rest, modes = body.rest[::stride].astype(np.float64), body.modes[:, ::stride]
        size, moved = np.zeros(len(rest)), np.full(len(rest), np.nan)
        if not modes.any():  # most of a scene: no need to project it at every timestep
            moved = np.where(_inside(rest, used[0]), 0.0, np.nan)
        else:
            for view in used:
                displaced = displacement_of(modes, motion.gains[view.timestep])
                size = np.maximum(size, np.linalg.norm(displaced, axis=1))
                step = projected_motion(rest + displaced, displaced, view)
                moved = np.fmax(moved, np.where(_inside(rest, view), step, np.nan))
        seen = ~np.isnan(moved)
        largest.append(size[seen])
        pixels.append(moved[seen])
    return _summed_up(views[0], "vertices", np.concatenate(largest), np.concatenate(pixels), amplitude)


def _inside(points: np.ndarray, view: View) -> np.ndarray:
    pixel, depth = project(points, view)
    width, height = view.size
    with np.errstate(invalid="ignore"):
        return (depth > 1e-9) & ((pixel >= 0) & (pixel < (width, height))).all(-1)


def _summed_up(
    view: View, source: str, displaced: np.ndarray, pixels: np.ndarray, amplitude: float
) -> ViewMotion:
    moving = pixels[displaced > MOVING * amplitude]
    still = float(np.mean(displaced <= STILL * amplitude)) if displaced.size else 1.0
    if not moving.size:
        return ViewMotion(view.split, view.name, source, 0.0, 0.0, 0.0, still, 0)
    p95, median = np.percentile(moving, [95, 50])
    return ViewMotion(
        view.split, view.name, source, float(moving.max()), float(p95), float(median), still, moving.size
    )


def _nanmax(values: np.ndarray) -> np.ndarray:
    """Maximum over the first axis, NaN where there are only NaNs, without a warning."""
    least = np.where(np.isnan(values), -np.inf, values).max(axis=0)
    return np.where(np.isneginf(least), np.nan, least)


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
