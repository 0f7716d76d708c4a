"""What `gpu.py` measures on where there is no capture of several timesteps: a scene, a known motion, its pictures."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from tg4mm.capture import Capture, ImageStack
from tg4mm.core.pictures.frames import to_bytes
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion import ModalMotion
from tg4mm.fit.motion.animate import animator
from tg4mm.show.render.cameras import look_at
from tg4mm.show.render.image import render_image

FPS, FREQUENCY, AMPLITUDE = 30.0, 5.0, 0.005  # Hz, Hz, share of the scene's extent


def synthetic(size: int = 64, views: int = 6, n: int = 300) -> tuple[Capture, ImageStack]:
    """A ball of coloured Gaussians from cameras around it, at one timestep: what --smoke trains on."""
    rng = np.random.default_rng(0)
    means = rng.normal(size=(n, 3))
    means /= np.linalg.norm(means, axis=1, keepdims=True)
    tensors = [
        means, rng.normal(size=(n, 4)), rng.uniform(0.05, 0.1, (n, 3)), np.full(n, 0.9), rng.normal(size=(n, 1, 3))
    ]  # fmt: skip
    gaussians = Gaussians(*(torch.from_numpy(a.astype(np.float32)) for a in tensors))
    around = 2 * np.pi * np.arange(views) / views
    places = 4 * np.stack([np.cos(around), np.sin(around), np.full(views, 0.5)], 1)
    viewmats = np.stack([look_at(place, np.zeros(3)) for place in places])
    K = np.array([[1.3 * size, 0, size / 2], [0, 1.3 * size, size / 2], [0, 0, 1]])
    capture = Capture(
        Path("."), "train", size, size, 0.0, 1, viewmats, np.repeat(K[None], views, 0), np.zeros(views, np.int64),
        np.arange(views), tuple(Path(f"r_{i:03d}.png") for i in range(views)),
    )  # fmt: skip
    return capture, photographed([gaussians], capture)


def photographed(poses: Sequence[Gaussians], capture: Capture) -> ImageStack:
    """Opaque 8-bit pictures of every pose, from the cameras of the capture's first timestep."""
    first = np.flatnonzero(capture.timesteps == 0)
    data = np.full((len(poses) * len(first), capture.height, capture.width, 4), 255, np.uint8)
    for t, pose in enumerate(poses):
        for j, i in enumerate(first):
            picture = render_image(pose, capture.viewmats[i], capture.Ks[i], capture.width, capture.height)
            data[t * len(first) + j, ..., :3] = to_bytes(picture)
    return ImageStack(data)


def sway(gaussians: Gaussians, n_timesteps: int) -> ModalMotion:
    """A post that bends along x at FREQUENCY: displacement grows with the square of the height, a sine of time."""
    z = gaussians.means[:, 2].cpu().numpy()
    low, high = np.percentile(z, [1, 99])
    height = np.clip((z - low) / max(high - low, 1e-9), 0, 1)
    phasor = np.zeros((1, len(z), 3), np.complex64)
    phasor[0, :, 0] = -1j * AMPLITUDE * (high - low) * height**2
    return ModalMotion(np.array([FREQUENCY]), phasor, np.zeros_like(phasor), FPS, n_timesteps)


def moving(gaussians: Gaussians, motion: ModalMotion, capture: Capture) -> tuple[Capture, ImageStack]:
    """The capture (of one timestep) again at every timestep of the motion."""
    T, views = motion.n_timesteps, len(capture)
    at = animator(gaussians, motion)
    images = photographed([at(t) for t in range(T)], capture)
    repeated = dataclasses.replace(
        capture, fps=motion.fps, n_timesteps=T, viewmats=np.tile(capture.viewmats, (T, 1, 1)),
        Ks=np.tile(capture.Ks, (T, 1, 1)), timesteps=np.repeat(np.arange(T), views),
        camera_ids=np.tile(capture.camera_ids, T), times_s=np.repeat(np.arange(T), views) / FPS,
        paths=capture.paths * T,
    )  # fmt: skip
    return repeated, images


def rest_view_of(capture: Capture) -> Capture:
    """The first image of every camera, as one timestep: what an orbit needs."""
    _, first = np.unique(capture.camera_ids, return_index=True)
    return dataclasses.replace(
        capture, n_timesteps=1, viewmats=capture.viewmats[first], Ks=capture.Ks[first],
        timesteps=np.zeros(len(first), np.int64), camera_ids=np.arange(len(first)),
        times_s=np.zeros(len(first)), paths=tuple(capture.paths[i] for i in first),
    )  # fmt: skip
