"""What other programs show of an exported run from close up, beside our own picture of that size, and the truth.

python -m benchmarks close_up RUN [--truth FOLDER] [--blender PYTHON] [--factors 1,2,4] [--views 2]

Test views of the run's dataset, enlarged by each factor. Ours is what `tg4mm render` draws. Beside it, PSNR in dB over
white: the exported PLY drawn by the plain formula without a low-pass; the exported SPZ as gsply reads it, drawn
likewise; with --blender, the Python of a bpy from 5.3 on, the PLY by Blender's own import and Cycles (64 samples,
view transform Standard). --truth: NeRF-synthetic, of the same test cameras and a multiple of the largest size.
"""

import argparse
import json
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.formats import drawn, of_spz
from benchmarks.low_pass import premultiplied, smaller
from tg4mm.capture import Capture, load_capture
from tg4mm.core.splatfile import read_splat
from tg4mm.run import Run
from tg4mm.show.export.formats import export_spz
from tg4mm.show.export.splat import export_ply
from tg4mm.show.render.cameras import Camera, capture_cameras
from tg4mm.show.render.image import render_image
from tg4mm.show.render.sequence import close_up

NO_LOW_PASS = 1e-6  # square pixels
CYCLES = """
import json, sys, bpy, mathutils
path, jobs = sys.argv[1], json.loads(sys.argv[2])
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.wm.ply_import(filepath=path, forward_axis="Y", up_axis="Z")
scene, data = bpy.context.scene, bpy.data.cameras.new("camera")
scene.camera = camera = bpy.data.objects.new("camera", data)
scene.collection.objects.link(camera)
scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 64, False
scene.cycles.transparent_max_bounces = 1024
scene.view_settings.view_transform, scene.render.dither_intensity = "Standard", 0.0
world = scene.world = bpy.data.worlds.new("white")
scene.render.film_transparent = True
for job in jobs:
    camera.matrix_world, data.angle = mathutils.Matrix(job["pose"]), job["angle"]
    scene.render.resolution_x = scene.render.resolution_y = job["size"]
    scene.render.filepath = job["out"]
    bpy.ops.render.render(write_still=True)
"""


def enlarged(camera: Camera, factor: int) -> Camera:
    K = camera.K * [[factor], [factor], [1]]
    return replace(camera, K=K, width=factor * camera.width, height=factor * camera.height)


def by_blender(python: str, ply: Path, cameras: list[Camera], folder: Path) -> list[np.ndarray]:
    """[H, W, 3] over white of each camera, by Blender's own import of the PLY and Cycles."""
    jobs = []
    for i, camera in enumerate(cameras):
        pose = np.linalg.inv(camera.viewmat) @ np.diag([1.0, -1, -1, 1])
        angle = 2 * float(np.arctan(camera.width / 2 / camera.K[0, 0]))
        out = str(folder / f"{i}.png")
        jobs.append({"pose": pose.tolist(), "angle": angle, "size": camera.width, "out": out})
    subprocess.run([python, "-c", CYCLES, str(ply), json.dumps(jobs)], check=True, stdout=subprocess.DEVNULL)
    found = [np.asarray(Image.open(job["out"]).convert("RGBA"), float) / 255 for job in jobs]
    return [rgba[..., :3] * rgba[..., 3:] + 1 - rgba[..., 3:] for rgba in found]


def true_picture(truth: Capture, view: int, side: int) -> np.ndarray:
    small = smaller(premultiplied(truth.paths[view]), truth.width // side)
    return small[..., :3] + 1 - small[..., 3:]


OPTIONS = {"run": Path, "--truth": Path, "--blender": str, "--factors": "1,2,4", "--views": 2}


def run(options: argparse.Namespace) -> None:
    """Print a row for each factor."""
    trained = Run.open(options.run)
    gaussians = trained.load_space()
    seen = close_up(trained, lambda _: gaussians)
    truth = None if options.truth is None else load_capture(options.truth, split="test")
    base = capture_cameras(load_capture(trained.dataset, split="test"))[: options.views]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        ply = export_ply(trained, folder / "a.ply")
        files = {"PLY": read_splat(ply), "SPZ, gsply": of_spz(export_spz(trained, folder / "a.spz"))}
        for factor in map(int, options.factors.split(",")):
            cameras = [enlarged(camera, factor) for camera in base]
            own = [render_image(seen(0.0, c), c.viewmat, c.K, c.width, c.height) for c in cameras]
            shown = {
                what: [drawn(splat, c, low_pass_px2=NO_LOW_PASS) for c in cameras]
                for what, splat in files.items()
            }
            if options.blender:
                shown["Blender, Cycles"] = by_blender(options.blender, ply, cameras, folder)
            row = [f"{what} {mean_psnr(pictures, own):.1f}" for what, pictures in shown.items()]
            if truth is not None:
                wanted = [true_picture(truth, i, c.width) for i, c in enumerate(cameras)]
                every = {"ours": own, **shown}.items()
                row += [f"truth | {what} {mean_psnr(pictures, wanted):.1f}" for what, pictures in every]
            print(f"{trained.path.name} {factor}x", *row, sep="  ", flush=True)


def mean_psnr(pictures: list[np.ndarray], others: list[np.ndarray]) -> float:
    errors = [np.square(np.asarray(a, float) - b).mean() for a, b in zip(pictures, others, strict=True)]
    return float(np.mean(-10 * np.log10(errors)))
