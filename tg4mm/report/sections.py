"""The sections on the capture and on how things move."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from markupsafe import Markup

from tg4mm.evaluate.slices import amplitude_spectrum
from tg4mm.render.frames import read_png
from tg4mm.report import svg
from tg4mm.report.figures import (
    contact_sheet,
    line_that_moves,
    map_picture,
    marked,
    phase_picture,
    scale_top,
    slice_picture,
)
from tg4mm.report.maps import in_band, leading_modes, main_direction, motion_maps, uncertainty_map
from tg4mm.report.page import Block, Figure, Panel, Section, Text, drawing, film, missing, picture
from tg4mm.report.sources import contact_images
from tg4mm.report.summary import Material, unit_of, vector
from tg4mm.report.svg import number


def capture_section(m: Material) -> Section:
    """Contact sheet and the figures of the recording."""
    t = m.train
    images = contact_images(t)
    views = len(set(t.camera_ids.tolist()))
    many = f"{len(images)} of the {views}" if len(images) < views else f"the {views}"
    scale = (
        "unknown, so lengths are in scene units"
        if t.unit_scale_m is None
        else f"1 scene unit = {number(t.unit_scale_m)} m"
    )
    steps = "one timestep"
    if t.n_timesteps > 1:
        rate = f"{number(t.fps)} Hz, {number(t.n_timesteps / t.fps)} s" if t.fps > 0 else "frame rate unknown"
        steps = f"{t.n_timesteps} timesteps ({rate})"
    count = "1 image" if len(t.paths) == 1 else f"{len(t.paths)} images"
    cameras = "1 training camera" if views == 1 else f"{views} training cameras"
    words = f"{cameras}, {steps}: {count} of {t.width} × {t.height} pixels. Scale: {scale}."
    caption = f"Training views: {many} cameras at their first timestep, in the order of the dataset."
    sheet = contact_sheet(images, columns=_columns(len(images)))
    return Section("The capture", [Text(words), Figure([picture(sheet, alt="training views")], caption)])


def _columns(n: int) -> int:
    """Between 5 and 10 columns, the number that leaves the fewest gaps in the last row, larger ones first."""
    return min(range(10, 4, -1), key=lambda c: -n % c) if n > 6 else max(n, 1)


def motion_section(m: Material) -> Section:
    """Slices, maps and spectrum; of a capture without motion one sentence."""
    if m.model.motion is None:
        return Section("The motion", [Text("One timestep was captured, so this model has no motion.")])
    blocks: list[Block] = [*_slices(m), _maps(m), _spectrum(m)]
    if m.orbit is not None:
        blocks.append(_orbit(m.orbit))
    return Section("The motion", blocks)


def _slices(m: Material) -> list[Block]:
    line = line_that_moves((m.view.ours if m.view.truth is None else m.view.truth) / np.float32(255))
    periods = max(1, math.ceil(24 / m.train.n_timesteps))
    seconds = number(periods * m.train.n_timesteps / m.train.fps)
    time = "Time runs to the right" if line.axis == "column" else "Time runs down"
    shape = f"{m.train.width} / {m.train.height}"  # as tall as the reference beside them
    named = [
        ("Input", m.view.input, m.view.why_no_input),
        (f"Ours, α = {m.view.alpha:g}", m.view.ours, ""),
        (f"Ground truth, α = {m.view.alpha:g}", m.view.truth, m.view.why_no_truth),
    ]
    panels: list[Panel] = [picture(marked(m.view.ours[0], line), "Where the slices are cut")]
    for label, video, why in named:
        if video is None:
            panels.append(missing(why, label))
        else:
            panels.append(picture(slice_picture(video, line, periods), label, f"slice: {label}", True, shape))
    caption = Markup(
        "Space-time slices: the pixels of {axis} {index} (marked; {start} to {stop}) over {seconds} s. "
        "{time}. "
        "What stands still draws straight lines; vibration draws waves, {gain} times as high after "
        "magnification. "
        "Waves should agree with the truth in height and phase; fringes and blur beside them are errors."
    ).format(
        axis=line.axis,
        index=line.index,
        start=line.start,
        stop=line.stop - 1,
        seconds=seconds,
        time=time,
        gain=f"{1 + m.view.alpha:g}",
    )
    return [Figure(panels, caption)]


def _maps(m: Material) -> Block:
    assert m.model.motion is not None
    seen = []
    for k in leading_modes(m.model.motion, m.model.weights, m.band):
        direction = main_direction(m.model.motion.displacement[k], m.model.weights)
        seen.append(
            (k, direction, motion_maps(m.model.gaussians, m.model.motion, k, direction, m.view.camera))
        )
    top = max(scale_top(maps.amplitude, maps.opacity) for _, _, maps in seen)
    panels, axes = [], []
    for k, direction, maps in seen:
        name = f"{number(float(m.model.motion.freqs_hz[k]))} Hz"
        strength = maps.amplitude / top if top > 0 else np.zeros_like(maps.amplitude)
        panels.append(picture(map_picture(maps.amplitude, top, maps.opacity), f"Amplitude at {name}"))
        panels.append(picture(phase_picture(maps.phase, strength, maps.opacity), f"Phase at {name}"))
        axes.append(f"({vector(direction)}) at {name}")
    caption = (
        "The motion of the surface under each pixel, in 3D, read from the model and not from the picture: "
        "peak displacement (the colour scale ends at its 99.5th percentile), and phase at timestep 0 of the "
        f"motion along {', '.join(axes)}, fading to grey below 20 % of the amplitude scale. Parts in step share "
        "one colour; parts half a turn (180°) apart move against each other."
    )
    if m.model.uncertainty is not None:
        unsure = uncertainty_map(m.model.gaussians, m.model.uncertainty, m.view.camera)
        panels.append(picture(map_picture(unsure, top, seen[0][2].opacity), "Uncertainty"))
        caption += (
            " Uncertainty is one standard deviation of the displacement, as the run says it, as the peak of a "
            "sinusoid and on the scale of the amplitude: where it is as bright, the motion is not to be relied on."
        )
    unit, factor = unit_of(m.train.unit_scale_m)
    legend = Markup('<div class="pair">{}{}</div>').format(
        svg.colour_bar(top * factor, unit, "peak displacement"), svg.phase_bar()
    )
    return Figure(panels, caption, legend=legend)


def _spectrum(m: Material) -> Block:
    assert m.model.motion is not None
    freqs, amplitudes = amplitude_spectrum(m.model.motion, m.model.weights)
    unit, factor = unit_of(m.train.unit_scale_m)
    inside = in_band(m.model.motion, m.band)[np.argsort(m.model.motion.freqs_hz, kind="stable")]
    chart = svg.bar_chart(
        freqs.tolist(),
        (amplitudes * factor).tolist(),
        inside.tolist(),
        "frequency (Hz)",
        f"mean amplitude ({unit})",
    )
    band = "every frequency" if m.band is None else f"{number(m.band[0])} to {number(m.band[1])} Hz"
    caption = (
        "Spectrum of the displacement: peak displacement at each frequency of the model, averaged over all "
        "Gaussians with their blending weight in the training views. Standing parts count, so the mean lies "
        f"well below the amplitude of what moves. Coloured bars are magnified ({band})."
    )
    return Figure([drawing(chart)], caption, width="narrow")


def _orbit(folder: Path) -> Block:
    first = read_png(folder / "r_000.png")
    panel = film((folder / "orbit.mp4").read_bytes(), first, alt="the scene from a moving camera")
    caption = "The magnified motion from a camera that no image was taken from, moving once around the scene."
    return Figure([panel], caption, width="small", controls=True)
