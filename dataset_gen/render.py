"""Renders one view of a stage: the picture, or the data passes of the surface points in the pixel centres.

Determinism is what this module owes the rest: a state and a view give the same bytes whenever, in whichever
process they are rendered. So the seed is fixed; adaptive sampling is off; dither is 0; and there is no
denoiser: it would blur away sub-pixel differences and invent others. The noise that is left is the same in
all timesteps of one state.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import bpy
import numpy as np

from . import compat, png
from .build import Stage
from .materials import DISPLACEMENT
from .quality import Quality
from .tree import temporary_name

# Rays of the data passes go through the pixel centre: the narrowest filter Blender has, ±0.005 px.
_POINT_FILTER = 0.01


def configure(stage: Stage, quality: Quality) -> None:
    """Sets the engine; call once after `build`."""
    scene = stage.scene
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y, render.resolution_percentage = (
        quality.width,
        quality.height,
        100,
    )
    render.film_transparent = True
    render.use_persistent_data = True  # cameras change more often than geometry does
    render.dither_intensity = 0.0
    render.use_file_extension = False
    render.threads_mode = "FIXED" if quality.threads else "AUTO"
    if quality.threads:
        render.threads = quality.threads
    scene.display_settings.display_device = "sRGB"
    scene.view_settings.view_transform = "Standard"
    scene.view_settings.look = "None"
    cycles.device = "CPU"
    cycles.use_denoising = False
    cycles.use_adaptive_sampling = False
    cycles.sampling_pattern = "TABULATED_SOBOL"
    cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = 4, 2, 3
    cycles.transmission_bounces, cycles.transparent_max_bounces = 0, 0
    cycles.caustics_reflective = cycles.caustics_refractive = False
    cycles.sample_clamp_indirect = 4.0  # no fireflies from metal seen in metal
    cycles.pixel_filter_type = "BLACKMAN_HARRIS"
    cycles.filter_width = 1.5
    scene.world.cycles.sampling_method = "NONE"  # the sky is smooth: no importance map needed
    layer = scene.view_layers[0]
    aov = layer.aovs.add()
    aov.name, aov.type = DISPLACEMENT, "COLOR"
    use_picture(stage, quality)


def use_picture(stage: Stage, quality: Quality) -> None:
    """The next renders are pictures."""
    stage.scene.cycles.samples, stage.scene.cycles.seed = quality.samples, quality.seed
    stage.scene.cycles.pixel_filter_type = "BLACKMAN_HARRIS"
    stage.scene.cycles.filter_width = 1.5
    _passes(stage, data=False)
    compat.set_png(stage.scene.render.image_settings)


def use_data(stage: Stage) -> None:
    """The next renders are data: one ray through each pixel centre, plain material, no filtering."""
    stage.scene.cycles.samples, stage.scene.cycles.seed = 1, 0
    stage.scene.cycles.pixel_filter_type = "GAUSSIAN"
    stage.scene.cycles.filter_width = _POINT_FILTER
    _passes(stage, data=True)
    compat.set_multilayer_exr(stage.scene.render.image_settings)


def _passes(stage: Stage, data: bool) -> None:
    layer = stage.scene.view_layers[0]
    layer.use_pass_z = layer.use_pass_normal = layer.use_pass_position = data
    layer.material_override = stage.data if data else None


def render_to(stage: Stage, path: Path) -> None:
    """Renders the current mode, state and view to a file; complete or absent, never half."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = temporary_name(path)
    stage.scene.render.filepath = str(temporary)
    bpy.ops.render.render(write_still=True)
    if path.suffix == ".png":
        temporary.write_bytes(png.essential(temporary.read_bytes()))
    os.replace(temporary, path)


def read_passes(path: Path) -> dict[str, np.ndarray]:
    """Passes of Blender's multilayer EXR: Depth [H, W]; Normal, Position, Displacement [H, W, 3] float32."""
    import OpenEXR

    channels = OpenEXR.File(str(path), separate_channels=True).channels()
    found: dict[str, np.ndarray] = {}
    for name, channel in channels.items():
        if match := re.search(r"(?:^|\.)(Depth|Normal|Position|displacement)\.([A-Z])$", name):
            found["".join(match.groups())] = channel.pixels
    depth = found.get("DepthZ", found.get("DepthV"))
    if depth is None:
        raise RuntimeError(f"{path.name}: no depth among the passes {sorted(channels)}")
    aov = "RGB" if "displacementR" in found else "XYZ"
    return {
        "Depth": depth,
        "Normal": np.stack([found[f"Normal{c}"] for c in "XYZ"], -1),
        "Position": np.stack([found[f"Position{c}"] for c in "XYZ"], -1),
        "Displacement": np.stack([found[f"displacement{c}"] for c in aov], -1),
    }
