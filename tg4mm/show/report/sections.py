"""The sections on the capture and on how things move."""

import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from tg4mm.core.pages import svg
from tg4mm.core.pages.charts import CEILING, MUTED, OURS, STILL, chart
from tg4mm.core.pages.page import Block, Figure, Section, Text, drawing, film, picture
from tg4mm.core.pages.svg import number
from tg4mm.core.phasors import main_direction, scale_top
from tg4mm.core.pictures.decode import read_png
from tg4mm.show.maps import evenly, leading_modes, motion_maps, uncertainty_map
from tg4mm.show.report.figures import (
    SliceLine,
    contact_sheet,
    line_that_moves,
    map_picture,
    marked,
    phase_picture,
    slice_picture,
)
from tg4mm.show.report.sources import contact_images
from tg4mm.show.report.spectra import model_spectrum
from tg4mm.show.report.summary import Material, vector, vibrations_table
from tg4mm.show.result.model import unit_of
from tg4mm.show.slices import Axis


def capture_section(m: Material) -> Section:
    """Return the contact sheet, the recording's figures and the camera map."""
    t = m.train
    images = contact_images(t)
    views = len(set(t.camera_ids.tolist()))
    many = f"{len(images)} of the {views}" if len(images) < views else f"the {views}"
    scale = "unknown, so lengths are in scene units"
    if t.unit_scale_m is not None:
        scale = f"1 scene unit = {number(t.unit_scale_m)} m"
    steps = "one timestep"
    if t.n_timesteps > 1:
        rate = f"{number(t.fps)} Hz, {number(t.n_timesteps / t.fps)} s" if t.fps > 0 else "frame rate unknown"
        steps = f"{t.n_timesteps} timesteps ({rate})"
    count = "1 image" if len(t.paths) == 1 else f"{len(t.paths)} images"
    cameras = "1 training camera" if views == 1 else f"{views} training cameras"
    words = f"{cameras}, {steps}: {count} of {t.width} × {t.height} pixels. Scale: {scale}."
    caption = f"Training views: {many} cameras at their first timestep, in the order of the dataset."
    sheet = contact_sheet(images, columns=_columns(len(images)))
    shown = Figure([picture(sheet, alt="training views", photo=True)], caption)
    return Section("The capture", [Text(words), shown, camera_map(m)])


def _columns(n: int) -> int:
    """Return the number of columns, 5 to 10, with the fewest gaps in the last row; of several the largest."""
    return min(range(10, 4, -1), key=lambda c: -n % c) if n > 6 else max(n, 1)


def motion_section(m: Material) -> Section:
    """Return slices, maps and spectrum; one sentence for a capture without motion."""
    if m.model.motion is None:
        return Section("The motion", [Text(m.why_still)])
    blocks: list[Block] = [slices(m), *vibrations_table(m), _maps(m), model_spectrum(m)]
    if m.orbit is not None:
        blocks.append(_orbit(m.orbit))
    return Section("The motion", blocks)


def _leading(m: Material) -> list[int]:
    """Return the modes to map: the strongest magnified vibrations, two at most, else the strongest modes."""
    assert m.model.motion is not None
    freqs = m.model.motion.freqs_hz
    inside = m.view.magnified.inside(freqs)
    found = [int(np.argmin(np.abs(freqs - v.hz))) for v in m.result.vibrations]
    magnified = [k for k in found if inside[k]][:2]
    return magnified or leading_modes(m.model.motion, m.model.weights, m.view.magnified)


def _maps(m: Material) -> Block:
    motion = m.model.motion
    assert motion is not None
    seen = []
    for k in _leading(m):
        direction = main_direction(motion.displacement[k], m.model.weights)
        seen.append((k, direction, motion_maps(m.model.gaussians, motion, k, direction, m.view.camera)))
    top = max(scale_top(maps.amplitude, maps.opacity) for _, _, maps in seen)
    panels, axes = [], []
    for k, direction, maps in seen:
        name = f"{number(float(motion.freqs_hz[k]))} Hz"
        strength = maps.amplitude / top if top > 0 else np.zeros_like(maps.amplitude)
        shown = (
            map_picture(maps.amplitude, top, maps.opacity),
            phase_picture(maps.phase, strength, maps.opacity),
        )
        for what, one in zip(("amplitude", "phase"), shown, strict=True):
            panels.append(
                picture(one, f"{what.title()} at {name}", f"map of the {what} at {name}", photo=True)
            )
        axes.append(f"({vector(direction)}) at {name}")
    caption = (
        "The motion of the surface under each pixel, in 3D, read from the model and not from the picture: "
        "peak displacement (the colour scale ends at its 99.5th percentile), and phase at timestep 0 of the "
        f"motion along {', '.join(axes)}, fading to grey below 20 % of the amplitude scale. Parts in step share "
        "one colour; parts half a turn (180°) apart move against each other."
    )
    if m.model.uncertainty is not None:
        unsure = uncertainty_map(m.model.gaussians, m.model.uncertainty, m.view.camera)
        one = map_picture(unsure, top, seen[0][2].opacity)
        panels.append(picture(one, "Uncertainty", "map of the uncertainty", photo=True))
        caption += (
            " Uncertainty is one standard deviation of the displacement, estimated by the run, as the peak of a "
            "sinusoid and on the scale of the amplitude: where it is as bright, the motion is unreliable."
        )
    unit, factor = unit_of(m.train)
    bars = svg.colour_bar(top * factor, unit, "peak displacement"), svg.phase_bar()
    return Figure(panels, caption, legend=Markup('<div class="pair">{}{}</div>').format(*bars))


def _orbit(folder: Path) -> Block:
    first = read_png(folder / "r_000.png")
    panel = film((folder / "orbit.mp4").read_bytes(), first, alt="the scene from a moving camera")
    caption = "The magnified motion from a camera that no image was taken from, moving around the scene."
    return Figure([panel], caption, width="small", controls=True)


_LEAST = 24  # pictures of a slice; a shorter record is repeated


def slices(m: Material) -> Block:
    """Return one figure; for a moving camera, slices of the model from one pose."""
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
    """Return "row" if the strongest vibration is more horizontal than vertical in the picture, else "column"."""
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


def _caption(m: Material, line: SliceLine, seconds: float) -> Markup:
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


_POINTS = 250  # drawn Gaussians
_ARROWS = 60  # cameras with a line of sight
_VIEWS = (("From above", 0, 1), ("From the side", 0, 2))  # title and the two world axes


def camera_map(m: Material) -> Block:
    """Return two charts side by side, lengths in metres if the scale is known."""
    scale = m.train.unit_scale_m
    factor, unit = (1.0, "scene units") if scale is None else (scale, "m")
    viewmats = m.train.viewmats[np.unique(m.train.camera_ids, return_index=True)[1]]
    eyes = -np.einsum("cij,ci->cj", viewmats[:, :3, :3], viewmats[:, :3, 3]) * factor
    points = _points(m) * factor
    low, high = np.percentile(points, [1, 99], axis=0)
    reach = 0.25 * float(np.median(np.linalg.norm(eyes - (low + high) / 2, axis=1)))
    tips, shown = eyes + reach * viewmats[:, 2, :3], m.view.camera.position * factor
    tip, arrows = shown + reach * m.view.camera.forward, evenly(len(eyes), _ARROWS)

    def draw(axes: Any, a: int, b: int) -> None:
        axes.plot(points[:, a], points[:, b], ".", ms=1.6, color=STILL, zorder=1)
        across, up = [low[a], high[a], high[a], low[a], low[a]], [low[b], low[b], high[b], high[b], low[b]]
        axes.plot(across, up, color=CEILING, lw=1.1, label="Gaussians, 98 % on each axis")
        for eye, end in zip(eyes[arrows], tips[arrows], strict=True):
            axes.plot([eye[a], end[a]], [eye[b], end[b]], color=MUTED, lw=0.7)
        axes.plot(eyes[:, a], eyes[:, b], "s", ms=3.2, color=MUTED, label="training cameras")
        axes.plot([shown[a], tip[a]], [shown[b], tip[b]], color=OURS, lw=1.4)
        axes.plot(shown[a], shown[b], "o", ms=6, color=OURS, label="the camera shown here")
        axes.set(xlabel=f"{'xyz'[a]}, {unit}", ylabel=f"{'xyz'[b]}, {unit}")
        axes.set_aspect("equal", adjustable="datalim")

    charts = []
    for title, a, b in _VIEWS:
        label = f"cameras and Gaussians {title.lower()}"
        charts.append(drawing(chart(partial(draw, a=a, b=b), label, (5.0, 4.2)), title))
    caption = (
        "Camera map in the world's axes, z up: squares are training cameras with their lines of sight, the large dot "
        "is the camera of the videos and maps, the box holds 98 % of the visible Gaussians on each axis, small dots "
        "are some of them."
    )
    return Figure(charts, caption)


def _points(m: Material) -> np.ndarray:
    """Draw some Gaussians [n, 3] by their blending weight."""
    means = m.model.gaussians.means.numpy().astype(np.float64)
    weights = np.maximum(m.model.weights, 0).astype(np.float64)
    if not weights.sum() > 0:
        weights = np.ones(len(means))
    chosen = np.random.default_rng(0).choice(len(means), _POINTS, p=weights / weights.sum())
    return means[chosen]
