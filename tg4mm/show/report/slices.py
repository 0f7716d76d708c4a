"""Space-time slices through the largest motion: input, ours, and the ground truth where there is one."""

from __future__ import annotations

import math

import numpy as np
from markupsafe import Markup

from tg4mm.core.pages.page import Block, Figure, picture
from tg4mm.core.pages.svg import number
from tg4mm.core.phasors import main_direction
from tg4mm.show.report.figures import Line, line_that_moves, marked, slice_picture
from tg4mm.show.report.summary import Material
from tg4mm.show.slices import Axis

_LEAST = 24  # pictures that a slice shows, by repeating a shorter record


def slices(m: Material) -> Block:
    """One figure; of a moving camera, slices of the model from one pose."""
    named = _named(m)
    shown = next(video for label, video in reversed(named) if video is not None)
    line = line_that_moves(shown / np.float32(255), _axis_of_motion(m))
    periods = max(1, math.ceil(_LEAST / len(shown))) if len(shown) == m.train.n_timesteps else 1
    shape = f"{m.train.width} / {m.train.height}"  # as tall as the reference beside them
    panels = [picture(marked(shown[0], line), "Where the slices are cut", photo=True)]
    panels += [
        picture(slice_picture(video, line, periods), label, f"space-time slice: {label}", True, shape)
        for label, video in named
    ]
    return Figure(panels, _caption(m, line, periods * len(shown) / m.train.fps))


def _axis_of_motion(m: Material) -> Axis | None:
    """Rows where the strongest vibration moves more to the sides than up and down in the picture; columns else."""
    motion = m.model.motion
    if motion is None or m.main is None:
        return None
    k = int(np.argmin(np.abs(motion.freqs_hz - m.main.hz)))
    right, down, _ = m.view.camera.viewmat[:3, :3] @ main_direction(motion.displacement[k], m.model.weights)
    return "row" if abs(right) >= abs(down) else "column"


def _named(m: Material) -> list[tuple[str, np.ndarray]]:
    magnified = f"α = {m.view.alpha:g}"
    if m.view.fixed is not None:
        still, ours = m.view.fixed
        return [("The model from one pose, α = 0", still), (f"The same, {magnified}", ours)]
    found = [("Input", m.view.input), (f"Ours, {magnified}", m.view.ours)]
    found.append((f"Ground truth, {magnified}", m.view.truth))
    return [(label, video) for label, video in found if video is not None]


def _caption(m: Material, line: Line, seconds: float) -> Markup:
    time = "Time runs to the right" if line.axis == "column" else "Time runs down"
    words = Markup(
        "Space-time slices: the pixels of {} {} (marked; {} to {}) over {} s. {}. "
        "What stands still draws straight lines; vibration draws waves, {} times as high after magnification."
    ).format(line.axis, line.index, line.start, line.stop - 1, number(seconds), time, f"{1 + m.view.alpha:g}")
    if m.view.fixed is not None:
        words += " The camera moved, so both slices are of the model, rendered from the pose that sees most motion."
    if m.view.truth is not None:
        words += (
            " Waves should agree with the truth in height and phase; fringes and blur beside them are errors."
        )
    return words
