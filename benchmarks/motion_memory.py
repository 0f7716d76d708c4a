"""Memory and time of the motion stage on pictures of any size and number, without a space stage.

    python -m benchmarks motion_memory OUT [--size 1920x1080] [--cameras 8] [--timesteps 300] [--gaussians 60000]
                                       [--moved 0.3] [--iterations 4] [--gauss-newton 1]

Random Gaussians rock about a vertical line by --moved pixels, six different pictures a period, which are written once
and repeated over time. Memory does not go by the number of iterations, so few are made. A line for each finished step:
most resident memory since the last one, processor seconds. Run it with OMP_NUM_THREADS=1.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from benchmarks.common import machine
from tg4mm.capture import Capture
from tg4mm.capture.pictures import FilePictures
from tg4mm.core.memory import peak_memory_mib, reset_peak_memory
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion import MotionConfig
from tg4mm.fit.motion.checkpoints import Arrays
from tg4mm.fit.motion.observations import observe
from tg4mm.fit.motion.pipeline import fit_motion
from tg4mm.fit.rasterize import rasterization

PERIOD = 6  # timesteps
FPS = 30.0
AWAY = 4.0  # scene units from the cameras to the middle


def random_scene(n: int) -> Gaussians:
    """N round Gaussians in a ball of one scene unit, as large as covers it."""
    rng = np.random.default_rng(0)
    means = rng.normal(size=(n, 3))
    means *= rng.uniform(size=(n, 1)) ** (1 / 3) / np.linalg.norm(means, axis=1, keepdims=True)
    sh = np.zeros((n, 1, 3), np.float32)
    sh[:, 0] = rng.normal(size=(n, 3))
    arrays = means, np.tile([1.0, 0, 0, 0], (n, 1)), np.full((n, 3), 0.8 * n ** (-1 / 3)), np.full(n, 0.6), sh
    return Gaussians(*(torch.from_numpy(np.asarray(a, np.float32)) for a in arrays))


def camera(k: int, count: int, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """World-to-camera (OpenCV axes) and intrinsics of camera k on a ring."""
    angle = 2 * np.pi * k / count
    forward = -np.array([np.cos(angle), np.sin(angle), 0])
    down = np.array([0, 0, -1.0])
    viewmat = np.eye(4)
    viewmat[:3, :3] = np.stack([np.cross(down, forward), down, forward])
    viewmat[2, 3] = AWAY
    focal = 1.6 * size[1]
    return viewmat, np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]])


def moved(gaussians: Gaussians, angle: float) -> Gaussians:
    """Sheared about the vertical axis: what is far from it moves by `angle` of its distance, up and down in turn."""
    means = gaussians.means.clone()
    means[:, 0] += angle * torch.sin(3 * gaussians.means[:, 2])
    return replace(gaussians, means=means)


def filmed(out: Path, gaussians: Gaussians, asked: argparse.Namespace) -> Capture:
    """The pictures that are not there yet, and the capture that repeats them."""
    size = width, height = asked.size
    cameras = [camera(k, asked.cameras, size) for k in range(asked.cameras)]
    largest = asked.moved * AWAY / cameras[0][1][0, 0]
    rng, files = np.random.default_rng(1), {}
    out.mkdir(parents=True, exist_ok=True)
    for k, (viewmat, K) in enumerate(cameras):
        for t in range(PERIOD):
            file = files[k, t] = out / f"{width}x{height}_{len(gaussians)}_{asked.moved:g}_{k:02d}_{t}.png"
            if file.is_file():
                continue
            g = moved(gaussians, largest * np.sin(2 * np.pi * t / PERIOD))
            own = (torch.from_numpy(a[None].astype(np.float32)) for a in (viewmat, K))
            arrays = g.means, g.quats, g.scales, g.opacities, g.sh
            white = torch.ones(1, 3)
            rgb, _, _ = rasterization(*arrays, *own, width, height, sh_degree=0, backgrounds=white)  # type: ignore[call-arg]
            noisy = rgb[0].numpy() * 255 + rng.normal(size=(height, width, 3)).astype(np.float32)
            Image.fromarray(np.clip(noisy + 0.5, 0, 255).astype(np.uint8)).save(file, compress_level=1)
    rows = [(t, k) for t in range(asked.timesteps) for k in range(asked.cameras)]
    ts, ks = (np.array(column) for column in zip(*rows, strict=True))
    paths = tuple(files[k, t % PERIOD] for t, k in rows)
    viewmats, Ks = (np.stack([cameras[k][i] for k in ks]) for i in (0, 1))
    return Capture(out, "train", width, height, FPS, asked.timesteps, viewmats, Ks, ts, ks, paths)


class Told:
    """`Checkpoint` that prints what each costs."""

    def __init__(self) -> None:
        self.most = 0.0
        self._began = time.process_time()
        reset_peak_memory()

    def __call__(self, name: str, compute: Callable[[], Arrays]) -> Arrays:
        self.line(f"before {name}")
        found = compute()
        self.line(name)
        return found

    def line(self, name: str) -> None:
        peak, seconds = peak_memory_mib(), time.process_time() - self._began
        self.most = max(self.most, peak)
        print(f"{name:<28} {peak:8.0f} MiB {seconds:8.1f} s", flush=True)
        reset_peak_memory()
        self._began = time.process_time()


def _size(text: str) -> tuple[int, ...]:
    return tuple(int(x) for x in text.split("x"))


OPTIONS = {
    "out": Path, "--size": {"type": _size, "default": (1920, 1080), "help": "pixels"}, "--cameras": 8,
    "--timesteps": 300, "--gaussians": 60_000,
    "--moved": {"type": float, "default": 0.3, "help": "pixels; above 0.7 by Gauss-Newton"},
    "--iterations": 4, "--gauss-newton": 1,
}  # fmt: skip


def run(options: argparse.Namespace) -> None:
    """Print the lines and the most."""
    asked = options
    print(machine())
    gaussians = random_scene(asked.gaussians)
    capture = filmed(asked.out, gaussians, asked)
    config = MotionConfig(iterations=asked.iterations, gauss_newton=asked.gauss_newton)
    told = Told()
    fit = fit_motion(gaussians, observe(capture, FilePictures(capture)), config, checkpoint=told)
    told.line("the rest")
    print(
        f"{asked.cameras} cameras of {capture.width}×{capture.height}, {asked.timesteps} timesteps, {asked.gaussians} "
        f"Gaussians, {fit.figures['components']} components, {fit.figures['pixels_moved']:.2f} px, "
        f"{fit.figures['gauss_newton']} Gauss-Newton iterations: {told.most:.0f} MiB at most"
    )
