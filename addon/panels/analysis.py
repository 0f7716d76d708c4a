"""The panel's data: spectrum, colour maps and legends, as the view transform displays them.

Only Blender itself can apply its view transforms, to a picture that it saves. That is done once for each setting of
the transform, by a timer, since nothing may be made while a panel or a view is drawn.
"""

import math
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from tg4mm.core.colour import STILL_BELOW, to_display
from tg4mm.core.errors import Tg4mmError

from .. import compat, names, preferences
from ..nodes import blending, clock, colours, scene
from ..nodes.points import gaussians, shown_size, values
from ..units import Unit
from . import plots

Key = tuple[Any, ...]
_known: dict[Key, tuple[plots.Rows, plots.Rows]] = {}

# Colours that the screen shows as the maps have them.
_AS_THEY_ARE = (("sRGB", "Standard", "None", 0.0, 1.0, False), ("sRGB", "Raw", "None", 0.0, 1.0, True))


def amplitude(scene: Any, encoded: bool = False) -> plots.Rows:
    """Return the amplitude colour map of this scene; until it is computed, the map under Standard.

    `encoded`: of an object whose colours are encoded for the screen before they are blended.
    """
    return _rows(scene, encoded)[0]


def phase(scene: Any, encoded: bool = False) -> plots.Rows:
    """Return the phase colour map and the grey of points that hardly move, like `amplitude`."""
    return _rows(scene, encoded)[1]


def through_view(linear: np.ndarray, scene: Any) -> np.ndarray:
    """Convert linear colours [K, 3] to sRGB in 0..1 through the view transform, by saving a picture."""
    image = bpy.data.images.new("tg4mm colours", len(linear), 1, float_buffer=True)
    try:
        rgba = np.concatenate([linear, np.ones((len(linear), 1))], axis=1)
        image.pixels.foreach_set(rgba.astype(np.float32).ravel())
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "colours.png"
            _save(image, file, scene)
            return blending.pixels(file.read_bytes())[0, :, :3].astype(np.float64)
    finally:
        bpy.data.images.remove(image)


def _save(image: Any, file: Path, scene: Any) -> None:
    settings = scene.render.image_settings
    before = {name: getattr(settings, name) for name in ("file_format", "color_mode", "color_depth")}
    dither, scene.render.dither_intensity = scene.render.dither_intensity, 0.0
    try:
        settings.file_format, settings.color_mode, settings.color_depth = "PNG", "RGBA", "16"
        image.save_render(str(file), scene=scene)
    finally:
        scene.render.dither_intensity = dither
        for name, value in before.items():
            setattr(settings, name, value)


def _rows(scene: Any, encoded: bool) -> tuple[plots.Rows, plots.Rows]:
    key = _key(scene, encoded)
    if key in _AS_THEY_ARE:
        return plots.STANDARD_AMPLITUDE, plots.STANDARD_PHASE
    if key not in _known:
        bpy.app.timers.register(partial(work_out, scene.name, encoded), first_interval=0.0)
        return plots.STANDARD_AMPLITUDE, plots.STANDARD_PHASE
    return _known[key]


def work_out(name: str, encoded: bool = False) -> None:
    """Find the maps of the scene called `name` for its view transform as it is now."""
    scene = bpy.data.scenes.get(name)
    if scene is None or (key := _key(scene, encoded)) in _known:
        return
    maps = colours.amplitude_map(), colours.phase_and_still()
    emitted = np.concatenate(maps)
    try:
        rows = through_view(to_display(emitted) if encoded else emitted, scene)
    except (OSError, RuntimeError):  # no room for the picture
        rows = to_display(emitted)
    as_rows = [tuple(map(tuple, part.tolist())) for part in np.split(rows, [len(maps[0])])]
    _known[key] = as_rows[0], as_rows[1]
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            area.tag_redraw()


def _key(scene: Any, encoded: bool) -> Key:
    view = scene.view_settings
    return (
        scene.display_settings.display_device,
        view.view_transform,
        view.look,
        round(view.exposure, 4),
        round(view.gamma, 4),
        encoded,
    )


def active_modes(obj: Any) -> list[int]:
    """Return the indices of the enabled modes inside the band."""
    modifier = scene.splat_modifier(obj)
    freqs = [float(f) for f in obj[names.FREQUENCIES]]
    low, high = (compat.get_input(modifier, name) for name in (names.LOW, names.HIGH))
    shown = names.toggles(freqs)
    slack = [1e-6 * max(1.0, f) for f in freqs]  # as in the node tree
    inside = [low < f + s and high > f - s for f, s in zip(freqs, slack, strict=True)]
    return [k for k, name in enumerate(shown) if inside[k] and compat.get_input(modifier, name)]


def band_amplitude(obj: Any) -> np.ndarray:
    """Return √Σ a_k² [N] over the active modes, unmagnified, scene units: the values of Colour By: Amplitude.

    Raises Tg4mmError if a person has removed the attributes that hold it.
    """
    every = [values(obj.data, names.amplitude(k)).astype(np.float64) for k in active_modes(obj)]
    return np.sqrt(sum((a**2 for a in every), np.zeros(gaussians(obj.data).sum())))


def fit_colour_range(obj: Any) -> float:
    """Set the colour range to the largest amplitude in the band, scene units, and return it.

    Raises Tg4mmError where nothing moves in the band.
    """
    largest = float(band_amplitude(obj).max(initial=0.0))
    if largest == 0.0:
        raise Tg4mmError("Nothing moves in the band")
    compat.set_input(scene.splat_modifier(obj), names.COLOUR_RANGE, largest)
    return largest


def metres_per_unit(obj: Any) -> float | None:
    """Return metres per world unit from the file's scale and the object's scaling, or None if unknown."""
    metres = obj.get(names.UNIT_SCALE)
    if metres is None or not (size := shown_size(obj)):
        return None
    return float(metres) / size


def units_differ(obj: Any, scene_: Any) -> str:
    """Return a warning if Blender's unit scale differs from the file's, else ""."""
    metres, settings = metres_per_unit(obj), scene_.unit_settings
    if (
        metres is None
        or settings.system == "NONE"
        or math.isclose(metres, settings.scale_length, rel_tol=1e-3)
    ):
        return ""
    return f"1 unit is {metres:.4g} m in the file, {settings.scale_length:.4g} m here"


def legend_picture(obj: Any, unit: Unit, settings: Any) -> tuple[Any, ...] | None:
    """Return the function of `plots` that draws the legend, with its arguments, or None.

    `settings`: the scene's, whose view transform the colours go through as the object's do.
    """
    modifier = scene.splat_modifier(obj)
    if modifier is None or not compat.has_input(modifier, names.COLOUR_BY):
        return None
    kind = compat.get_input(modifier, names.COLOUR_BY)
    if kind == names.FILE_COLOUR:
        return None
    highest = compat.get_number(modifier, names.COLOUR_RANGE)
    encoded = compat.has_input(modifier, names.BLEND) and bool(compat.get_input(modifier, names.BLEND))
    if kind == names.PHASE_COLOUR:
        return plots.phase_legend, STILL_BELOW * highest, unit, phase(settings, encoded)
    return plots.amplitude_legend, highest, unit, amplitude(settings, encoded)


def band(obj: Any) -> tuple[float, float]:
    """Return the band (low, high) in Hz."""
    low, high = (compat.get_number(scene.splat_modifier(obj), name) for name in (names.LOW, names.HIGH))
    return low, high


def set_band(obj: Any, low: float, high: float) -> None:
    """Set the band in Hz."""
    modifier = scene.splat_modifier(obj)
    compat.set_input(modifier, names.LOW, low)
    compat.set_input(modifier, names.HIGH, high)


def mode_strengths(obj: Any, measure: str) -> list[float]:
    """Return each mode's amplitude in scene units: the maximum over Gaussians (PEAK) or the rms (RMS)."""
    largest = [float(a) for a in obj[names.MODE_AMPLITUDES]]
    return largest if measure == "PEAK" else [float(a) for a in obj.get(names.MODE_RMS, largest)]


def spectrum_picture(context: Any, obj: Any) -> tuple[Any, ...]:
    """Return the function that draws an object's spectrum, with its arguments."""
    measure = context.window_manager.tg4mm_view.measure
    freqs = tuple(float(f) for f in obj[names.FREQUENCIES])
    highest = clock.whole_band(freqs, float(obj[names.FPS]))[1]
    title = {"RMS": "Motion (rms)", "PEAK": "Largest"}[measure]
    unit = preferences.unit_for(context, obj)
    return plots.spectrum, freqs, tuple(mode_strengths(obj, measure)), band(obj), highest, title, unit


def peaks(obj: Any) -> list[float]:
    """Return the frequencies in Hz of the peaks of an object's spectrum."""
    freqs = [float(f) for f in obj[names.FREQUENCIES]]
    bin_hz = float(obj[names.FPS]) / max(int(obj[names.TIMESTEPS]), 1)
    return [freqs[k] for k in clock.peaks(freqs, mode_strengths(obj, "RMS"), bin_hz)]
