"""The colour maps as the scene's view transform shows them, so that a legend looks like the object beside it.

Only Blender itself can apply its view transforms, to a picture that it saves. That is done once for each setting of
the transform, by a timer, since nothing may be made while a panel or a view is drawn.
"""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from . import colours, plots

Key = tuple[Any, ...]
_known: dict[Key, tuple[plots.Rows, plots.Rows]] = {}


def amplitude(scene: Any) -> plots.Rows:
    """The map for amplitudes in this scene; as under Standard while it is not worked out yet."""
    return _rows(scene)[0]


def phase(scene: Any) -> plots.Rows:
    """The map for phases, then the grey of what hardly moves; likewise."""
    return _rows(scene)[1]


def through_view(linear: np.ndarray, scene: Any) -> np.ndarray:
    """[K, 3] sRGB in 0..1 of linear colours [K, 3], by way of a saved picture."""
    image = bpy.data.images.new("tg4mm colours", len(linear), 1, float_buffer=True)
    shown = None
    try:
        rgba = np.concatenate([linear, np.ones((len(linear), 1))], axis=1)
        image.pixels.foreach_set(rgba.astype(np.float32).ravel())
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "colours.png"
            _save(image, file, scene)
            shown = bpy.data.images.load(str(file))
            shown.colorspace_settings.name = "Non-Color"
            pixels = np.empty(4 * len(linear), np.float32)
            shown.pixels.foreach_get(pixels)
    finally:
        for made in (image, shown):
            if made is not None:
                bpy.data.images.remove(made)
    return pixels.reshape(-1, 4)[:, :3].astype(np.float64)


def _save(image: Any, file: Path, scene: Any) -> None:
    """Save as a PNG through the scene's view transform, its other picture settings kept."""
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


def _rows(scene: Any) -> tuple[plots.Rows, plots.Rows]:
    key = _key(scene)
    if _is_standard(key):
        return plots.STANDARD_AMPLITUDE, plots.STANDARD_PHASE
    if key not in _known:
        bpy.app.timers.register(partial(work_out, scene.name), first_interval=0.0)
        return plots.STANDARD_AMPLITUDE, plots.STANDARD_PHASE
    return _known[key]


def work_out(name: str) -> None:
    """Find the maps of the scene called `name` for its view transform as it is now."""
    scene = bpy.data.scenes.get(name)
    if scene is None or (key := _key(scene)) in _known:
        return
    maps = colours.amplitude_map(), colours.phase_and_still()
    rows = through_view(np.concatenate(maps), scene)
    as_rows = [tuple(map(tuple, part.tolist())) for part in np.split(rows, [len(maps[0])])]
    _known[key] = as_rows[0], as_rows[1]
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            area.tag_redraw()


def _key(scene: Any) -> Key:
    view = scene.view_settings
    return (
        scene.display_settings.display_device,
        view.view_transform,
        view.look,
        round(view.exposure, 4),
        round(view.gamma, 4),
    )


def _is_standard(key: Key) -> bool:
    return key == ("sRGB", "Standard", "None", 0.0, 1.0)
