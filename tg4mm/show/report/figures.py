"""Pictures of the report: contact sheet, space-time slices, maps, and the videos side by side in step."""

import math
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from markupsafe import Markup
from PIL import Image, ImageDraw

from tg4mm.core.choices import Clock
from tg4mm.core.colour import STILL, amount_colours, phase_colours, phase_share
from tg4mm.core.digits import number
from tg4mm.core.pages.page import Block, Figure, FigurePanel, Text, film, missing, picture
from tg4mm.core.pictures.decode import to_bytes
from tg4mm.show.maps import Axis, most_moving_line, space_time_slice
from tg4mm.show.render.video import loops_to_last, write_mp4
from tg4mm.show.report.summary import Material

MARK = (217, 72, 15)
_MOST = 2_500_000  # bytes of one clip
_LARGEST, _SMALLEST = 720, 240  # pixels of the longer side
_SCREEN = 60.0  # pictures a second of a screen
_SLOWED = 30.0


@dataclass(frozen=True)
class SliceLine:
    """The pixels of a row or column in a space-time slice."""

    axis: Axis
    index: int  # which row or column, pixels
    start: int  # first pixel along it
    stop: int  # one past the last

    def __str__(self) -> str:
        return f"{self.axis} {self.index}, pixels {self.start} to {self.stop - 1}"


def contact_sheet(images: list[np.ndarray], columns: int, gap: int = 4, edge: int = 160) -> np.ndarray:
    """Arrange uint8 pictures [H, W, 3] in a grid, each at most `edge` pixels, gaps transparent: [h, w, 4] uint8."""
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


def line_that_moves(video: np.ndarray, axis: Axis | None = None, margin: float = 0.12) -> SliceLine:
    """Return the line of a video [T, H, W, 3] with most change, cut to the changing part plus a margin.

    axis: "row" or "column"; None: the one that changes most.
    """
    axis, index = most_moving_line(video, axis)
    line = video[:, index] if axis == "row" else video[:, :, index]
    change = line.astype(np.float64).var(axis=0).mean(axis=-1)
    length = len(change)
    moving = np.flatnonzero(change > 0.02 * change.max()) if change.max() > 0 else np.arange(length)
    pad = max(4, round(margin * length))
    return SliceLine(axis, index, max(0, int(moving[0]) - pad), min(length, int(moving[-1]) + 1 + pad))


def slice_picture(video: np.ndarray, line: SliceLine, periods: int = 1) -> np.ndarray:
    """Return the slice of a uint8 video, `periods` times over; time runs right for a column, down for a row."""
    picture = space_time_slice(video, line.axis, line.index)
    if line.axis == "row":
        return np.tile(picture[:, line.start : line.stop], (periods, 1, 1))
    return np.tile(picture[line.start : line.stop], (1, periods, 1))


def marked(image: np.ndarray, line: SliceLine, edge: int = 512) -> np.ndarray:
    """Enlarge a uint8 picture to about `edge` pixels and draw the line on it."""
    height, width = image.shape[:2]
    scale = max(1, round(edge / max(height, width)))
    big = Image.fromarray(image).resize((width * scale, height * scale), Image.Resampling.BICUBIC)
    draw = ImageDraw.Draw(big)
    across, start, stop = (line.index + 0.5) * scale, line.start * scale * 1.0, line.stop * scale - 1.0
    thick = max(2, round(0.006 * max(big.size)))
    tick = 3 * thick
    segments = [((start, across), (stop, across))]
    segments += [((end, across - tick), (end, across + tick)) for end in (start, stop)]
    for segment in segments:
        draw.line([end if line.axis == "row" else end[::-1] for end in segment], fill=MARK, width=thick)
    return np.asarray(big)


def map_picture(values: np.ndarray, top: float, opacity: np.ndarray | None = None) -> np.ndarray:
    """Return amounts [H, W] from 0 to `top` as colours: [H, W, 4] uint8, transparent where `opacity` is 0."""
    colours = amount_colours(values / top if top > 0 else np.zeros_like(values))
    alpha = np.ones(values.shape) if opacity is None else np.clip(opacity, 0, 1)
    return to_bytes(np.concatenate([colours, alpha[..., None]], -1))


def phase_picture(phase: np.ndarray, strength: np.ndarray, opacity: np.ndarray) -> np.ndarray:
    """Return phases [H, W] in radians as hues, fading to grey where `strength` (0..1) is small: [H, W, 4] uint8."""
    weight = phase_share(strength)[..., None]
    colours = weight * phase_colours(phase) + (1 - weight) * STILL
    return to_bytes(np.concatenate([colours, np.clip(opacity, 0, 1)[..., None]], -1))


def videos(m: Material) -> list[Block]:
    """Return one figure of videos in step; stills for a capture of one timestep."""
    if m.model.motion is None:
        return _stills(m)
    rate, still, magnified = playing_rate(m.train.fps), m.view.widest_time, f"α = {m.view.alpha:g}"
    named = [("Input, as captured", m.view.input), (f"Ours, {magnified}", m.view.ours)]
    if m.view.truth is not None:
        named.append((f"Ground truth, {magnified}", m.view.truth))
    panels: list[FigurePanel] = [
        film(clip(video, rate), video[still], label, f"video: {label}")
        for label, video in named
        if video is not None
    ]
    if m.view.why_no_truth:
        panels.append(missing(m.view.why_no_truth, f"Ground truth, {magnified}"))
    seconds = round(len(m.view.ours) / rate, 4)
    blocks: list[Block] = [Figure(panels, _caption(m, rate), controls=True, seconds=seconds)]
    return [*blocks, Text(f"{m.warning}.", "note")] if m.warning else blocks


def _caption(m: Material, rate: float) -> Markup:
    camera = Markup("The {} camera <code>{}</code>, which sees most of the motion,").format(
        m.view.split, m.view.camera.name
    )
    if m.view.clock == Clock.moving:
        camera = Markup("The camera as it moved; ours is rendered from the same poses,")
    speed = "in real time" if rate == m.train.fps else f"slowed down {number(m.train.fps / rate)} times"
    size = f"{m.train.width} × {m.train.height} pixels"
    words = Markup("{} {} ({} Hz, {}, repeated). ").format(camera, speed, number(m.train.fps), size)
    if len(m.view.ours) < m.view.n_frames:
        words += f"The first {len(m.view.ours)} of {m.view.n_frames} pictures. "
    band = "" if m.band is None else f" from {m.band[0]:g} to {m.band[1]:g} Hz"
    words += (
        "Input is what the camera recorded; ours is the model rendered with every displacement "
        f"δ{band} as (1 + {m.view.alpha:g}) δ. "
    )
    words += f"{m.why_alpha} " if m.why_alpha else ""
    if m.view.clock == Clock.independent:
        words += "This camera has an independent clock, so the two may be out of step. "
    if m.view.truth is None:
        return words + "Look for edges that stay sharp while they move."
    return words + (
        "Look for edges that stay sharp while they move, and for anything that moves in ours but not in the truth."
    )


def _stills(m: Material) -> list[Block]:
    panels = [picture(m.view.ours[0], "The static model, rendered", photo=True)]
    if m.view.input is not None:
        panels.insert(0, picture(m.view.input[0], "Input, as captured", photo=True))
    caption = Markup(
        "The {split} camera <code>{camera}</code> at timestep 0. There is no motion to play."
    ).format(split=m.view.split, camera=m.view.camera.name)
    return [Figure(panels, caption)]


def playing_rate(fps: float) -> float:
    """Return the pictures a second at which a record is shown: the recorded rate, or less if too fast for a screen."""
    return fps if fps <= _SCREEN else _SLOWED


def clip(frames: np.ndarray, fps: float, seconds: float = 4.0, edge: int = 384) -> bytes:
    """Encode uint8 frames [T, H, W, 3] as mp4, repeated to last `seconds`; small ones are enlarged.

    At most 720 pixels a side, and less if the file would exceed 2.5 MB.
    """
    scale = max(1, math.floor(edge / max(frames.shape[1:3]) + 0.5))
    largest = float(_LARGEST)
    while True:
        data = _encoded(_reduced(frames, largest), fps, seconds, scale)
        if len(data) <= _MOST or largest <= _SMALLEST:
            return data
        largest = max(_SMALLEST, largest * max(0.5, math.sqrt(_MOST / len(data)) * 0.95))


def _encoded(frames: np.ndarray, fps: float, seconds: float, scale: int) -> bytes:
    with tempfile.TemporaryDirectory(prefix="tg4mm-") as folder:
        path = Path(folder) / "clip.mp4"
        write_mp4(path, list(frames), fps, loops_to_last(len(frames), fps, seconds), scale, quality=20)
        return path.read_bytes()


def _reduced(frames: np.ndarray, largest: float) -> np.ndarray:
    height, width = frames.shape[1:3]
    share = largest / max(height, width)
    if share >= 1:
        return frames
    size = max(2, round(width * share)), max(2, round(height * share))
    return np.stack([np.asarray(Image.fromarray(f).resize(size, Image.Resampling.LANCZOS)) for f in frames])
