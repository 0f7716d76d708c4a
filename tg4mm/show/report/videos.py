"""The videos side by side: input, ours, and the ground truth where there is one, in step and with one slider."""

import math
import tempfile
from pathlib import Path

import numpy as np
from markupsafe import Markup
from PIL import Image

from tg4mm.core.choices import Clock
from tg4mm.core.pages.page import Block, Figure, Panel, Text, film, missing, picture
from tg4mm.core.pages.svg import number
from tg4mm.show.render.video import loops_to_last, write_mp4
from tg4mm.show.report.summary import Material


def videos(m: Material) -> list[Block]:
    """One figure; of a capture of one timestep, stills."""
    if m.model.motion is None:
        return _stills(m)
    rate, still, magnified = playing_rate(m.train.fps), m.view.widest_time, f"α = {m.view.alpha:g}"
    named = [("Input, as captured", m.view.input), (f"Ours, {magnified}", m.view.ours)]
    if m.view.truth is not None:
        named.append((f"Ground truth, {magnified}", m.view.truth))
    panels: list[Panel] = [
        film(clip(video, rate), video[still], label, f"video: {label}")
        for label, video in named
        if video is not None
    ]
    if m.view.why_no_truth:
        panels.append(missing(m.view.why_no_truth, f"Ground truth, {magnified}"))
    blocks: list[Block] = [
        Figure(panels, _caption(m, rate), controls=True, seconds=round(len(m.view.ours) / rate, 4))
    ]
    blocks += [Text(f"{line}.", "note") for line in [m.warning] if line]
    return blocks


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
        words += "This camera has a clock of its own, so the two need not be in step. "
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


_MOST = 2_500_000  # bytes of one clip
_LARGEST, _SMALLEST = 720, 240  # pixels of the longer side
_SCREEN = 60.0  # pictures a second that a screen shows
_SLOWED = 30.0


def playing_rate(fps: float) -> float:
    """Pictures a second that a record is shown at: its own, slower where a screen could not follow."""
    return fps if fps <= _SCREEN else _SLOWED


def clip(frames: np.ndarray, fps: float, seconds: float = 4.0, edge: int = 384) -> bytes:
    """An mp4 of uint8 frames [T, H, W, 3], repeated to last `seconds`; small ones are enlarged, large ones reduced.

    At most 720 pixels a side, and less where the file would be larger than 2.5 MB.
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
