"""Space-time slices of an ablation's rows beside the ground truth's, as [TG4MM] Fig. 8 shows them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tg4mm.capture import Capture, load_capture
from tg4mm.core.filters import TemporalFilter
from tg4mm.core.magnification import BandGain, Magnification
from tg4mm.core.pictures.frames import to_bytes
from tg4mm.research.bench.methods.camera_videos import most_changing
from tg4mm.research.bench.pages.sheet import write_sheet
from tg4mm.research.bench.sets import alpha_to_show
from tg4mm.research.evaluate.scores import render_views
from tg4mm.run import Run
from tg4mm.run.poses import poses_of
from tg4mm.show.slices import most_moving_line, space_time_slice

_HEIGHT = 96  # pixels of a slice in the picture


@dataclass(frozen=True)
class Magnified:
    """A run and how it is magnified."""

    label: str
    run: Path
    method: str
    filter: str | None


def slices_picture(
    root: Path, alphas: Sequence[int], band_hz: Sequence[float] | None, shown: Sequence[Magnified], out: Path
) -> str:
    """Write the picture to `out`; returns a sentence that says what it shows.

    The line of pixels along which most changes over time, in the test camera where that is most; time runs down.
    """
    alpha = alpha_to_show(alphas)
    capture = load_capture(root, split="test", magnification=alpha)
    images, truth = most_changing(capture)
    axis, index = most_moving_line(truth)
    rows = {"ground truth": space_time_slice(truth, axis, index)}
    for one in shown:
        video = _rendered(one, capture, images, alpha, band_hz)
        rows[one.label] = space_time_slice(video, axis, index)
    if axis == "column":  # [H, T, 3]: time is brought down here too
        rows = {label: np.swapaxes(piece, 0, 1) for label, piece in rows.items()}
    write_sheet(out, {label: to_bytes(piece) for label, piece in rows.items()}, _HEIGHT)
    name = capture.paths[images[0]].name
    return f"Space-time slices of {axis} {index} of test camera {name} at α = {alpha}; time runs down."


def _rendered(
    one: Magnified, capture: Capture, images: np.ndarray, alpha: int, band_hz: Sequence[float] | None
) -> np.ndarray:
    bands = () if band_hz is None else (BandGain(band_hz[0], band_hz[1], alpha),)
    chosen = None if one.filter is None else TemporalFilter(one.filter)
    everywhere = float(alpha) if band_hz is None else 0.0
    plan = Magnification(bands=bands, everywhere=everywhere, method=one.method, filter=chosen)
    poses = poses_of(Run.open(one.run), plan)
    times = capture.timesteps[images].tolist()
    views = [render_views(poses.at(t), capture, images[j : j + 1])[0] for j, t in enumerate(times)]
    return np.stack(views)
