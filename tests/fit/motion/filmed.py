"""The synthetic scene filmed by cameras with clocks of their own, and by one that moves: exact observations."""

import math

import numpy as np
import torch

from tests.helpers.synthetic import CAMERA_ANGLE_X, _at, _gaussians, _motion, _parts, _viewmats
from tg4mm.capture import ImageStack
from tg4mm.core.choices import Kind
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.observations import Observations, PosedFrames
from tg4mm.fit.motion.pipeline import fit_motion
from tg4mm.fit.rasterize import rasterization

FPS, SIZE = 30.0, 48


def scene(frequency, amplitude=0.01):
    """The Gaussians at rest and their exact motion at `frequency` Hz."""
    parts = _parts(1)
    return _gaussians(parts, 1), _motion(parts, (frequency,), amplitude, FPS, 10_000)


def K_of(size):
    """[3, 3] of square pictures."""
    focal = size / (2 * math.tan(CAMERA_ANGLE_X / 2))
    return np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]], np.float32)


@torch.no_grad()
def picture(gaussians, viewmat, noise, size=SIZE):
    """[H, W, 4] uint16 over white, opaque; with a sensor's noise of one step of 8 bits."""
    g = gaussians
    rgb, _, _ = rasterization(
        g.means, g.quats, g.scales, g.opacities, g.sh, torch.as_tensor(viewmat, dtype=torch.float32)[None],
        torch.from_numpy(K_of(size))[None], size, size, sh_degree=0, backgrounds=torch.ones(1, 3),
    )  # fmt: skip
    out = np.full((size, size, 4), 65535, np.uint16)
    noisy = rgb[0].numpy() + noise.normal(size=(size, size, 3)) * 0.004
    out[..., :3] = (noisy.clip(0, 1) * 65535 + 0.5).astype(np.uint16)
    return out


def clips(gaussians, motion, starts, n_frames, kind="clips"):
    """One clip from each of several places, each begun at `starts` timesteps of the motion, its clock at 0."""
    frames, pictures, noise = [], [], np.random.default_rng(7)
    for c, viewmat in enumerate(_viewmats(len(starts), 0.0)):
        rows = np.arange(len(pictures), len(pictures) + n_frames)
        moved = [_at(gaussians, motion, starts[c] + t, 0) for t in range(n_frames)]
        pictures += [picture(g, viewmat, noise) for g in moved]
        times = np.arange(n_frames) / FPS
        frames.append(PosedFrames(f"cam_{c:02d}", viewmat.astype(np.float32), K_of(SIZE), rows, times))
    stack = ImageStack(np.stack(pictures))
    return Observations(Kind(kind), "independent", frames, stack, FPS, n_frames, True)


def walk(gaussians, motion, n_frames, tremor=0.0, seed=1):
    """One camera that moves around the scene all the time; `tremor` radians that its known poses are off by."""
    rng, noise = np.random.default_rng(seed), np.random.default_rng(seed + 1)
    frames, pictures = [], []
    for t in range(n_frames):
        viewmat = _viewmats(40, 0.1 + 6 * t / n_frames)[0]
        now = gaussians if motion is None else _at(gaussians, motion, t, 0)
        pictures.append(picture(now, viewmat, noise))
        off = np.eye(4)
        x, y, z = rng.normal(size=3) * tremor
        off[:3, :3] = [[1, -z, y], [z, 1, -x], [-y, x, 1]]
        known = (off @ viewmat).astype(np.float32)
        frames.append(PosedFrames(f"{t:03d}", known, K_of(SIZE), np.array([t]), np.array([t / FPS])))
    stack = ImageStack(np.stack(pictures))
    return Observations(Kind.handheld, "moving", frames, stack, FPS, n_frames, True)


def error_of(found, true, opacities):
    """rms/rms of complex displacements [N, 3], weighted by opacity."""
    weights = opacities[:, None]
    return float(np.sqrt((weights * np.abs(found - true) ** 2).sum() / (weights * np.abs(true) ** 2).sum()))


def fitted(gaussians, observations, nuisance="auto"):
    config = MotionConfig(nuisance=nuisance, smoothness_weight=100.0, appearance=False)
    return fit_motion(gaussians, observations, config)


def length(values):
    return float(np.linalg.norm(np.abs(values).astype(np.float64)))


def at_hz(fit, hz):
    return fit.motion.displacement[int(np.argmin(np.abs(fit.motion.freqs_hz - hz)))]


def elsewhere(fit, hz):
    """rms of what moves at other frequencies, over that at the true one."""
    other = np.abs(fit.motion.freqs_hz - hz) > 1
    return length(fit.motion.displacement[other]) / length(at_hz(fit, hz))
