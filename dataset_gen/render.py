"""Renders one view of a stage: the picture, or the data passes of the surface points in the pixel centres.

Determinism is what this module owes the rest: a state and a view give the same bytes whenever, in whichever
process they are rendered. So the seed is fixed; adaptive sampling is off; dither is 0; and there is no
denoiser: it would blur away sub-pixel differences and invent others. The noise that is left is the same in
all timesteps of one state. (EEVEE has no seed; its pictures repeat on one machine, not from one to another.)

A picture leaves Blender as linear light in 32-bit floats, so that one render serves every file format and
any sensor; `pictures` does the rest.
"""

import importlib.util
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from tg4mm.core.pictures import exr

from . import compat
from .build import DISPLACEMENT, Stage, trees
from .compat import device_in_use, use_device
from .settings import Quality

# Rays of the data passes go through the pixel centre: Cycles' first sample does, and there is no other. The narrowest
# filter that Blender has, in case another line draws it from the filter: σ = 0.0025 px.
_POINT_FILTER = 0.01
_PIXEL_FILTER = 1.5  # px, of pictures
_BRIGHTEST = 65504.0  # what the file formats hold; a path that went wrong may be infinite
_TRANSMITS = {"ShaderNodeBsdfGlass", "ShaderNodeBsdfRefraction", "ShaderNodeBsdfTranslucent"}
_TRANSPARENT = {"ShaderNodeBsdfTransparent", "ShaderNodeBsdfRayPortal", "ShaderNodeHoldout"}


def configure(stage: Stage, quality: Quality) -> str:
    """Sets the engine; call once after `build`. Returns the device that renders, "CPU" or "CUDA: <names>".

    Raises GenerateError if a GPU is wanted and Blender finds none.
    """
    scene = stage.scene
    set_size(stage, quality)
    _output(scene, quality)
    device = use_device(scene, quality.device) if quality.engine == "cycles" else "OpenGL or Vulkan"
    cycles = scene.cycles
    cycles.use_denoising = False
    cycles.use_adaptive_sampling = False
    cycles.sampling_pattern = "TABULATED_SOBOL"
    bounces_for(scene).apply(scene)
    cycles.caustics_reflective = cycles.caustics_refractive = False
    cycles.sample_clamp_indirect = 4.0  # no fireflies from metal seen in metal
    cycles.film_exposure = 1.0
    aovs = scene.view_layers[0].aovs
    if DISPLACEMENT not in aovs:
        aov = aovs.add()
        aov.name, aov.type = DISPLACEMENT, "COLOR"
    if quality.engine == "eevee":
        _eevee(scene)
    use_picture(stage, quality)
    return device


def _output(scene: bpy.types.Scene, quality: Quality) -> None:
    render = scene.render
    render.resolution_percentage = 100
    render.pixel_aspect_x = render.pixel_aspect_y = 1.0
    render.use_border = render.use_multiview = render.use_motion_blur = False
    render.use_compositing = render.use_sequencer = render.use_freestyle = False
    render.film_transparent = True
    render.use_persistent_data = True  # cameras change more often than geometry does
    render.dither_intensity = 0.0
    render.use_file_extension = False
    render.threads_mode = "FIXED" if quality.threads else "AUTO"
    if quality.threads:
        render.threads = quality.threads
    scene.display_settings.display_device = "sRGB"
    view = scene.view_settings
    view.view_transform, view.look = "Standard", "None"
    view.exposure, view.gamma, view.use_curve_mapping = 0.0, 1.0, False


def _eevee(scene: bpy.types.Scene) -> None:
    scene.eevee.use_raytracing = True
    for material in transmitting(scene):
        material.use_raytrace_refraction = True


def set_size(stage: Stage, quality: Quality) -> None:
    """Size of the next renders, pixels."""
    _set(stage.scene.render, resolution_x=quality.width, resolution_y=quality.height)


def _set(owner: Any, **values: Any) -> None:
    """Sets what differs: a setting that is set again, to what it is, has Blender send the whole scene once more."""
    for name, value in values.items():
        if getattr(owner, name) != value:
            setattr(owner, name, value)


def use_picture(stage: Stage, quality: Quality, seed_offset: int = 0) -> None:
    """The next renders are pictures; `seed_offset` gives the same picture with other noise."""
    set_size(stage, quality)
    scene = stage.scene
    engine = compat.eevee() if quality.engine == "eevee" else "CYCLES"
    # EEVEE's filter: at equal size its edges are as wide as Cycles'
    _set(scene.render, engine=engine, filter_size=_PIXEL_FILTER)
    _set(scene.eevee, taa_render_samples=quality.samples)
    seed = (quality.seed + seed_offset) % 2**31
    _set(scene.cycles, device=device_in_use(), samples=quality.samples, seed=seed)
    _set(scene.cycles, pixel_filter_type="BLACKMAN_HARRIS", filter_width=_PIXEL_FILTER)
    _passes(stage, data=False)
    compat.set_float_exr(scene.render.image_settings)


def use_data(stage: Stage) -> None:
    """The next renders are data: one ray through each pixel centre, plain material, no filtering.

    By Cycles on the processor whatever makes the pictures, so that truth is the same everywhere.
    """
    scene = stage.scene
    _set(scene.render, engine="CYCLES")
    _set(scene.cycles, device="CPU", samples=1, seed=0)
    _set(scene.cycles, pixel_filter_type="GAUSSIAN", filter_width=_POINT_FILTER)
    _passes(stage, data=True)
    compat.set_multilayer_exr(scene.render.image_settings)


def _passes(stage: Stage, data: bool) -> None:
    layer = stage.scene.view_layers[0]
    _set(layer, use_pass_z=data, use_pass_normal=data, use_pass_position=data)
    _set(layer, material_override=stage.data if data else None)


def linear_picture(stage: Stage) -> np.ndarray:
    """The picture of the current state and view: [H, W, 4] float32, linear Rec.709, premultiplied, row 0 on top.

    After `use_picture`.
    """
    with tempfile.TemporaryDirectory(prefix="dataset_gen_") as scratch:
        raw = Path(scratch) / "linear.exr"
        _render_to(stage, raw)
        pixels = read_float(raw)
    return np.nan_to_num(pixels, nan=0.0, posinf=_BRIGHTEST, neginf=0.0)


def data_passes(stage: Stage) -> dict[str, np.ndarray]:
    """Render the data passes at the pixel centres of the current state and view; call `use_data` first.

    Depth [H, W]; Normal, Position, Displacement [H, W, 3] float32; `truth.write_exr` says what they mean.
    """
    with tempfile.TemporaryDirectory(prefix="dataset_gen_") as scratch:
        raw = Path(scratch) / "passes.exr"
        _render_to(stage, raw)
        return read_passes(raw)


@contextmanager
def rows_alone(stage: Stage, rows: slice, size: int) -> Iterator[None]:
    """Cycles renders these rows of a picture and one more on either side; the others are 0. EEVEE renders all."""
    render = stage.scene.render
    render.use_border, render.use_crop_to_border = render.engine == "CYCLES", False
    render.border_min_x, render.border_max_x = 0.0, 1.0
    render.border_min_y = max(1 - (rows.stop + 1) / size, 0.0)
    render.border_max_y = min(1 - (rows.start - 1) / size, 1.0)
    try:
        yield
    finally:
        render.use_border = False


def _render_to(stage: Stage, path: Path) -> None:
    stage.scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True, scene=stage.scene.name)


def read_float(path: Path) -> np.ndarray:
    """Read an EXR of Blender, [H, W, 4] float32, row 0 on top; through Blender itself if OpenEXR is absent."""
    if importlib.util.find_spec("OpenEXR") is None:
        return read_float_by_blender(path)
    channels = exr.stored(path)
    return np.stack([channels[name] for name in "RGBA"], axis=-1).astype(np.float32, copy=False)


def read_float_by_blender(path: Path) -> np.ndarray:
    """Like `read_float`, but by Blender."""
    image = bpy.data.images.load(str(path))
    try:
        image.colorspace_settings.name = "Non-Color"
        image.alpha_mode = "CHANNEL_PACKED"  # numbers as they are stored
        width, height = image.size
        pixels = np.empty(width * height * 4, np.float32)
        image.pixels.foreach_get(pixels)
    finally:
        bpy.data.images.remove(image)
    return np.ascontiguousarray(pixels.reshape(height, width, 4)[::-1])


def read_passes(path: Path) -> dict[str, np.ndarray]:
    """Passes of Blender's multilayer EXR: Depth [H, W]; Normal, Position, Displacement [H, W, 3] float32."""
    channels = exr.stored(path)
    found: dict[str, np.ndarray] = {}
    for name, pixels in channels.items():
        if match := re.search(r"(?:^|\.)(Depth|Normal|Position|displacement)\.([A-Z])$", name):
            found["".join(match.groups())] = pixels
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


@dataclass(frozen=True)
class Bounces:
    """Cycles' limits, in bounces of one light path."""

    total: int = 4
    diffuse: int = 2
    glossy: int = 3
    transmission: int = 0
    transparent: int = 0

    def apply(self, scene: bpy.types.Scene) -> None:
        """Sets the scene's limits."""
        cycles = scene.cycles
        cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = (
            self.total,
            self.diffuse,
            self.glossy,
        )
        cycles.transmission_bounces, cycles.transparent_max_bounces = self.transmission, self.transparent
        cycles.volume_bounces = 0


OPAQUE = Bounces()
GLASS = Bounces(total=10, diffuse=2, glossy=4, transmission=8, transparent=8)
CUT_OUT = Bounces(transparent=8)  # leaves cut out of a rectangle by alpha: passing through is no bounce


def bounces_for(scene: bpy.types.Scene) -> Bounces:
    """The least that shows every material of the scene's objects."""
    if transmitting(scene):
        return GLASS
    return CUT_OUT if any(map(_cut_out, _used(scene))) else OPAQUE


def transmitting(scene: bpy.types.Scene) -> list[bpy.types.Material]:
    """Materials of the scene's objects that light goes through with a turn: glass, water, thin leaves."""
    return [material for material in _used(scene) if any(map(_transmits, nodes_of(material)))]


def _used(scene: bpy.types.Scene) -> list[bpy.types.Material]:
    used = {s.material.name: s.material for obj in scene.objects for s in obj.material_slots if s.material}
    return list(used.values())


def _transmits(node: bpy.types.Node) -> bool:
    weight = _principled(node, "Transmission Weight")
    return node.bl_idname in _TRANSMITS or _is_not(weight, 0.0)


def _cut_out(material: bpy.types.Material) -> bool:
    nodes = nodes_of(material)
    return any(n.bl_idname in _TRANSPARENT or _is_not(_principled(n, "Alpha"), 1.0) for n in nodes)


def _is_not(socket: bpy.types.NodeSocket | None, value: float) -> bool:
    """Return whether the socket exists and may differ from the value."""
    return socket is not None and bool(socket.is_linked or socket.default_value != value)


def _principled(node: bpy.types.Node, socket: str) -> bpy.types.NodeSocket | None:
    return node.inputs.get(socket) if node.bl_idname == "ShaderNodeBsdfPrincipled" else None


def nodes_of(material: bpy.types.Material) -> Iterator[bpy.types.Node]:
    """All nodes of a material, those inside groups too."""
    return (node for tree in trees([material.node_tree]) for node in tree.nodes)
