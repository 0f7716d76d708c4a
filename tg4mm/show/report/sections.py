"""The sections on the capture and on how things move."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from markupsafe import Markup

from tg4mm.core.pages import svg
from tg4mm.core.pages.page import Block, Figure, Section, Text, film, picture
from tg4mm.core.pages.svg import number
from tg4mm.core.phasors import main_direction, scale_top
from tg4mm.core.pictures.frames import read_png
from tg4mm.show.report.camera_map import camera_map
from tg4mm.show.report.figures import contact_sheet, map_picture, phase_picture
from tg4mm.show.report.found import vibrations_table
from tg4mm.show.report.maps import in_band, leading_modes, motion_maps, uncertainty_map
from tg4mm.show.report.slices import slices
from tg4mm.show.report.sources import contact_images
from tg4mm.show.report.spectra import model_spectrum
from tg4mm.show.report.summary import Material, unit_of, vector


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
    shown = Figure([picture(sheet, alt="training views", photo=True)], caption)
    return Section("The capture", [Text(words), shown, camera_map(m)])


def _columns(n: int) -> int:
    """Between 5 and 10 columns, the number that leaves the fewest gaps in the last row, larger ones first."""
    return min(range(10, 4, -1), key=lambda c: -n % c) if n > 6 else max(n, 1)


def motion_section(m: Material) -> Section:
    """Slices, maps and spectrum; of a capture without motion one sentence."""
    if m.model.motion is None:
        return Section("The motion", [Text("One timestep was captured, so this model has no motion.")])
    blocks: list[Block] = [slices(m), *vibrations_table(m), _maps(m), model_spectrum(m)]
    if m.orbit is not None:
        blocks.append(_orbit(m.orbit))
    return Section("The motion", blocks)


def _leading(m: Material) -> list[int]:
    """Modes that are worth a map: the strongest vibrations that are magnified, two at most; else the strongest mode."""
    assert m.model.motion is not None
    freqs = m.model.motion.freqs_hz
    inside = in_band(m.model.motion, m.band)
    found = [int(np.argmin(np.abs(freqs - v.hz))) for v in m.result.vibrations]
    return [k for k in found if inside[k]][:2] or leading_modes(m.model.motion, m.model.weights, m.band)


def _maps(m: Material) -> Block:
    assert m.model.motion is not None
    seen = []
    for k in _leading(m):
        direction = main_direction(m.model.motion.displacement[k], m.model.weights)
        seen.append(
            (k, direction, motion_maps(m.model.gaussians, m.model.motion, k, direction, m.view.camera))
        )
    top = max(scale_top(maps.amplitude, maps.opacity) for _, _, maps in seen)
    panels, axes = [], []
    for k, direction, maps in seen:
        name = f"{number(float(m.model.motion.freqs_hz[k]))} Hz"
        strength = maps.amplitude / top if top > 0 else np.zeros_like(maps.amplitude)
        seen_as = map_picture(maps.amplitude, top, maps.opacity)
        panels.append(picture(seen_as, f"Amplitude at {name}", f"map of the amplitude at {name}", photo=True))
        seen_as = phase_picture(maps.phase, strength, maps.opacity)
        panels.append(picture(seen_as, f"Phase at {name}", f"map of the phase at {name}", photo=True))
        axes.append(f"({vector(direction)}) at {name}")
    caption = (
        "The motion of the surface under each pixel, in 3D, read from the model and not from the picture: "
        "peak displacement (the colour scale ends at its 99.5th percentile), and phase at timestep 0 of the "
        f"motion along {', '.join(axes)}, fading to grey below 20 % of the amplitude scale. Parts in step share "
        "one colour; parts half a turn (180°) apart move against each other."
    )
    if m.model.uncertainty is not None:
        unsure = uncertainty_map(m.model.gaussians, m.model.uncertainty, m.view.camera)
        seen_as = map_picture(unsure, top, seen[0][2].opacity)
        panels.append(picture(seen_as, "Uncertainty", "map of the uncertainty", photo=True))
        caption += (
            " Uncertainty is one standard deviation of the displacement, as the run says it, as the peak of a "
            "sinusoid and on the scale of the amplitude: where it is as bright, the motion is not to be relied on."
        )
    unit, factor = unit_of(m.train.unit_scale_m)
    legend = Markup('<div class="pair">{}{}</div>').format(
        svg.colour_bar(top * factor, unit, "peak displacement"), svg.phase_bar()
    )
    return Figure(panels, caption, legend=legend)


def _orbit(folder: Path) -> Block:
    first = read_png(folder / "r_000.png")
    panel = film((folder / "orbit.mp4").read_bytes(), first, alt="the scene from a moving camera")
    caption = "The magnified motion from a camera that no image was taken from, moving around the scene."
    return Figure([panel], caption, width="small", controls=True)
