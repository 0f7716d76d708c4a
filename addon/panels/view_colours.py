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

from ..nodes import colours, images
from . import plots

Key = tuple[Any, ...]
_known: dict[Key, tuple[plots.Rows, plots.Rows]] = {}


def amplitude(scene: Any, encoded: bool = False) -> plots.Rows:
    """The map for amplitudes in this scene; as under Standard while it is not worked out yet.

    `encoded`: of an object whose colours are encoded for the screen before they are blended.
    """
    return _rows(scene, encoded)[0]


def phase(scene: Any, encoded: bool = False) -> plots.Rows:
    """The map for phases, then the grey of what hardly moves; likewise."""
    return _rows(scene, encoded)[1]


def through_view(linear: np.ndarray, scene: Any) -> np.ndarray:
    """[K, 3] sRGB in 0..1 of linear colours [K, 3], by way of a saved picture."""
    image = bpy.data.images.new("tg4mm colours", len(linear), 1, float_buffer=True)
    try:
        rgba = np.concatenate([linear, np.ones((len(linear), 1))], axis=1)
        image.pixels.foreach_set(rgba.astype(np.float32).ravel())
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "colours.png"
            _save(image, file, scene)
            return images.pixels(file.read_bytes())[0, :, :3].astype(np.float64)
    finally:
        bpy.data.images.remove(image)


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
        rows = through_view(colours.display(emitted) if encoded else emitted, scene)
    except (OSError, RuntimeError):  # no room for the picture
        rows = colours.display(emitted)
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


# Colours that the screen shows as the maps have them.
_AS_THEY_ARE = (("sRGB", "Standard", "None", 0.0, 1.0, False), ("sRGB", "Raw", "None", 0.0, 1.0, True))
