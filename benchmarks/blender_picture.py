"""An exported file in the Blender extension beside the core's own picture of it, in the bpy that runs this.

python -m benchmarks.blender_picture SPLAT.ply CAMERAS.json OUT [--view 0] [--alpha 50] [--timestep 1] [--size 256]

Draws the splats of an exported file (its scales hold the low-pass) from one camera of a NeRF-synthetic transforms file,
over white, by Cycles with 4 samples: blended in linear light and as trained. Writes OUT/<version>_linear.png and
_trained.png, and prints their PSNR against OUT/core.png, which is the rasteriser's picture of the same file, made where
torch is installed. In an environment without it (Blender 5.2's) OUT/core.png has to be there.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import tempfile
from pathlib import Path

import bpy
import mathutils
import numpy as np
from PIL import Image

from benchmarks.blender import load
from tg4mm.core.splatfile import positions_at, read_splat

ROOT = Path(__file__).resolve().parent.parent


def core_picture(options: argparse.Namespace, pose: np.ndarray, angle: float) -> np.ndarray:
    """[H, W, 3] by the core's rasteriser without a low-pass of its own."""
    import torch

    from tg4mm.fit.rasterize import rasterization

    splat, side = read_splat(options.splat), options.size
    means = positions_at(splat, options.timestep, options.alpha)
    viewmat = np.diag([1.0, -1.0, -1.0, 1.0]) @ np.linalg.inv(pose)
    focal = side / 2 / np.tan(angle / 2)
    K = [[focal, 0, side / 2], [0, focal, side / 2], [0, 0, 1]]
    arrays = (means, splat.quats, splat.scales, splat.opacities, splat.sh, viewmat[None], [K])
    tensors = [torch.as_tensor(np.asarray(a), dtype=torch.float32) for a in arrays]
    rgb, _, _ = rasterization(
        *tensors, side, side, eps2d=1e-6, sh_degree=splat.sh_degree, backgrounds=torch.ones(1, 3)
    )
    return rgb[0].clamp(0, 1).numpy()


def set_scene(pose: np.ndarray, angle: float, size: int) -> None:
    """The camera, and Cycles with few samples over nothing."""
    scene = bpy.context.scene
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.matrix_world, camera.data.angle = mathutils.Matrix(pose.tolist()), angle
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.render.engine, scene.render.film_transparent = "CYCLES", True
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.seed = 4, False, 1
    scene.render.dither_intensity = 0.0
    scene.render.image_settings.file_format, scene.render.image_settings.color_mode = "PNG", "RGBA"


def blender_pictures(options: argparse.Namespace, pose: np.ndarray, angle: float) -> dict[str, np.ndarray]:
    """[H, W, 3] over white of each way to blend."""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        builder = load("make_extension", ROOT / "addon" / "make_extension.py")
        staged = builder.stage(Path(folder) / "tg4mm_extension")
        extension = load("tg4mm_extension", staged / "__init__.py", staged)
        bpy.ops.wm.read_factory_settings(use_empty=True)
        extension.register()
        bpy.ops.import_scene.tg4mm_splat(filepath=str(options.splat))
        modifier, names = extension.nodes.scene.splat_modifier(bpy.context.object), extension.names
        set_scene(pose, angle, options.size)
        for name, value in (
            (names.DRAW, names.SPLATS),
            (names.ALPHA, options.alpha),
            (names.VIEW_COLOUR, True),
        ):
            extension.compat.set_input(modifier, name, value)
        for kind, as_trained in (("linear", False), ("trained", True)):
            bpy.ops.tg4mm.blend_as_trained(on=as_trained)
            bpy.context.scene.frame_set(1 + options.timestep)
            path = options.out / f"{bpy.app.version_string.split()[0]}_{kind}.png"
            bpy.context.scene.render.filepath = str(path.resolve())
            bpy.ops.render.render(write_still=True)
            rgba = np.asarray(Image.open(path), float) / 255
            found[kind] = rgba[..., :3] * rgba[..., 3:] + 1 - rgba[..., 3:]
        extension.unregister()
    return found


def main() -> None:
    """Print the two figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("splat", type=Path, help="exported splat file with motion")
    parser.add_argument("cameras", type=Path, help="transforms file, NeRF-synthetic")
    parser.add_argument("out", type=Path, help="folder for the pictures")
    parser.add_argument("--view", type=int, default=0, help="which camera of the file")
    parser.add_argument("--alpha", type=float, default=50.0)
    parser.add_argument("--timestep", type=int, default=1)
    parser.add_argument("--size", type=int, default=256, help="pixels")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    cameras = json.loads(options.cameras.read_text(encoding="utf-8"))
    pose = np.array(cameras["frames"][options.view]["transform_matrix"])
    angle, core = float(cameras["camera_angle_x"]), options.out / "core.png"
    if importlib.util.find_spec("torch") is not None:
        picture = core_picture(options, pose, angle)
        Image.fromarray((picture * 255 + 0.5).astype(np.uint8)).save(core)
    wanted = np.asarray(Image.open(core).convert("RGB"), float) / 255
    for kind, picture in blender_pictures(options, pose, angle).items():
        psnr = -10 * np.log10(np.square(picture - wanted).mean())
        print(f"Blender {bpy.app.version_string}, blended {kind:8s} {psnr:.1f} dB", flush=True)


if __name__ == "__main__":
    main()
