"""An exported file in the Blender extension beside the core's own picture of it, in the bpy that runs this.

python -m benchmarks blender_picture SPLAT.ply CAMERAS.json OUT [--view 0] [--alphas 0,20,50]
    [--timestep 1] [--size 256] [--draw Native,Splats,Ellipsoids] [--engine CYCLES] [--samples 4]

Draws an exported file (its scales hold the low-pass) from one camera of a NeRF-synthetic transforms file, over white,
in each way to draw that this Blender has: blended in linear light and as trained. Writes
OUT/<version>_<way>_<alpha>.png
and prints PSNR and seconds against OUT/core_<alpha>.png, the rasteriser's picture of the same file, made where torch is
installed. In an environment without it (Blender 5.2's and 5.3's) that has to be there.
"""

import argparse
import contextlib
import importlib.util
import json
import time
from functools import partial
from pathlib import Path
from types import ModuleType

import bpy
import mathutils
import numpy as np
from PIL import Image

from benchmarks.blender import registered
from tg4mm.core.splatfile import positions_at, read_splat


def core_picture(options: argparse.Namespace, pose: np.ndarray, angle: float, alpha: float) -> np.ndarray:
    """[H, W, 3] by the core's rasteriser without a low-pass of its own."""
    import torch

    from tg4mm.fit.rasterize import rasterization

    splat, side = read_splat(options.splat), options.size
    means = positions_at(splat, options.timestep, alpha)
    viewmat = np.diag([1.0, -1.0, -1.0, 1.0]) @ np.linalg.inv(pose)
    focal = side / 2 / np.tan(angle / 2)
    K = [[focal, 0, side / 2], [0, focal, side / 2], [0, 0, 1]]
    arrays = (means, splat.quats, splat.scales, splat.opacities, splat.sh, viewmat[None], [K])
    tensors = [torch.as_tensor(np.asarray(a), dtype=torch.float32) for a in arrays]
    rgb, _, _ = rasterization(  # type: ignore[call-arg]
        *tensors, side, side, eps2d=1e-6, sh_degree=splat.sh_degree, backgrounds=torch.ones(1, 3)
    )
    return rgb[0].clamp(0, 1).numpy()


def set_scene(pose: np.ndarray, angle: float, options: argparse.Namespace) -> None:
    """The camera, and the engine over nothing."""
    scene = bpy.context.scene
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.matrix_world, camera.data.angle = mathutils.Matrix(pose.tolist()), angle
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.resolution_x = scene.render.resolution_y = options.size
    for engine in (options.engine, f"BLENDER_{options.engine}", f"BLENDER_{options.engine}_NEXT"):
        with contextlib.suppress(TypeError):  # of another version
            scene.render.engine = engine
    scene.render.film_transparent = True
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.seed = options.samples, False, 1
    scene.eevee.taa_render_samples = options.samples
    scene.render.dither_intensity = 0.0
    scene.render.image_settings.file_format, scene.render.image_settings.color_mode = "PNG", "RGBA"


def blender_picture(path: Path) -> np.ndarray:
    """[H, W, 3] over white; the RGBA picture is kept at `path`."""
    bpy.context.scene.render.filepath = str(path.resolve())
    bpy.ops.render.render(write_still=True)
    rgba = np.asarray(Image.open(path), float) / 255
    return rgba[..., :3] * rgba[..., 3:] + 1 - rgba[..., 3:]


OPTIONS = {
    "splat": {"type": Path, "help": "exported splat file with motion"},
    "cameras": {"type": Path, "help": "transforms file, NeRF-synthetic"},
    "out": {"type": Path, "help": "folder for the pictures"},
    "--view": {"type": int, "default": 0, "help": "which camera of the file"},
    "--alphas": "0,20,50",
    "--timestep": 1,
    "--size": 256,  # pixels
    "--draw": "Native,Splats,Ellipsoids",
    "--engine": {"default": "CYCLES", "help": "CYCLES, EEVEE or WORKBENCH"},
    "--samples": 4,
}


def run(options: argparse.Namespace) -> None:
    """Print a line for each way to draw and α."""
    options.out.mkdir(parents=True, exist_ok=True)
    cameras = json.loads(options.cameras.read_text(encoding="utf-8"))
    pose = np.array(cameras["frames"][options.view]["transform_matrix"])
    angle, alphas = float(cameras["camera_angle_x"]), [float(a) for a in options.alphas.split(",")]
    if importlib.util.find_spec("torch") is not None:
        for alpha in alphas:
            picture = core_picture(options, pose, angle, alpha)
            Image.fromarray((picture * 255 + 0.5).astype(np.uint8)).save(options.out / f"core_{alpha:g}.png")
    with registered() as extension:
        bpy.ops.import_scene.tg4mm_splat(filepath=str(options.splat.resolve()))
        set_scene(pose, angle, options)
        draw_all(extension, options, alphas)


def draw_all(extension: ModuleType, options: argparse.Namespace, alphas: list[float]) -> None:
    """Print the figures of every way to draw that this Blender has."""
    modifier, names = extension.nodes.scene.splat_modifier(bpy.context.object), extension.names
    put, version = partial(extension.compat.set_input, modifier), bpy.app.version_string.split()[0]
    bpy.context.scene.frame_set(1 + options.timestep)
    for draw in options.draw.split(","):
        if draw == "Native" and not extension.compat.native_splats():
            continue
        put(names.DRAW, draw)
        for as_trained in (False, True):
            if extension.compat.has_input(modifier, names.VIEW_COLOUR):
                put(names.VIEW_COLOUR, True)
            bpy.ops.tg4mm.blend_as_trained(on=as_trained)
            for alpha in alphas:
                put(names.ALPHA, alpha)
                way = f"{options.engine.lower()}_{draw.lower()}{'_trained' if as_trained else ''}"
                start = time.perf_counter()
                picture = blender_picture(options.out / f"{version}_{way}_{alpha:g}.png")
                took = time.perf_counter() - start
                core = Image.open(options.out / f"core_{alpha:g}.png").convert("RGB")
                psnr = -10 * np.log10(np.square(picture - np.asarray(core, float) / 255).mean())
                print(f"{version} {way:28s} α {alpha:3g}  {psnr:5.1f} dB  {took:6.1f} s", flush=True)
