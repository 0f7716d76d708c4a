"""Runs on generated pictures of exact motion: the floor stands still, the post and the ball move as specified."""

import json
from collections.abc import Callable

import numpy as np
import torch
from PIL import Image

from tests.helpers.synthetic import CAMERA_ANGLE_X, _gaussians, _parts, _viewmats
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.rasterize import rasterization
from tg4mm.run import Run

FPS, SIZE = 30.0, 48
PARTS = [len(p.vertices) for p in _parts(1)]
POST, BALL = slice(PARTS[0], PARTS[0] + PARTS[1]), slice(PARTS[0] + PARTS[1], sum(PARTS))
BALL_SPHERE = "ball=sphere:0.5,0.1,0.37,0.33"

Displacement = Callable[[float], np.ndarray]  # seconds -> [N, 3] scene units


def model():
    """The scene at rest."""
    return _gaussians(_parts(1), 1)


def of_parts(**moves):
    """post=…, ball=…: functions of time in seconds that give [3] scene units."""

    def displacement(t):
        out = np.zeros((sum(PARTS), 3))
        for name, move in moves.items():
            out[{"post": POST, "ball": BALL}[name]] = move(t)
        return out

    return displacement


@torch.no_grad()
def pictures(gaussians, shift, viewmats, noise, rng):
    """[V, H, W, 3] uint8 over white, with white noise of that standard deviation (0 … 1)."""
    g, n = gaussians, len(viewmats)
    focal = SIZE / (2 * np.tan(CAMERA_ANGLE_X / 2))
    K = torch.tensor([[focal, 0, SIZE / 2], [0, focal, SIZE / 2], [0, 0, 1.0]], dtype=torch.float32)
    means = g.means + torch.as_tensor(shift, dtype=torch.float32)
    rgb, _, _ = rasterization(
        means, g.quats, g.scales, g.opacities, g.sh, torch.as_tensor(viewmats, dtype=torch.float32),
        K.expand(n, 3, 3), SIZE, SIZE, sh_degree=0, backgrounds=torch.ones(n, 3),
    )  # fmt: skip
    noisy = rgb.numpy() + noise * rng.normal(size=rgb.shape)
    return (noisy.clip(0, 1) * 255 + 0.5).astype(np.uint8)


def filmed(
    path, displacement, n_views=6, n_timesteps=45, noise=0.01, seed=0, kind="", walks=False, starts=()
):
    """A dataset in `path`/set: of fixed cameras, or of one that `walks` by a radian around the scene.

    starts: seconds at which each camera's own clock begins; by default all at 0.
    """
    gaussians, rng = model(), np.random.default_rng(seed)
    fixed = np.stack(_viewmats(n_views, 0.0))
    for t in range(n_timesteps):
        viewmats = np.stack(_viewmats(40, 0.1 + 6 * t / n_timesteps)[:1]) if walks else fixed
        folder = path / "set" / f"{t:03d}"
        (folder / "train").mkdir(parents=True)
        frames = []
        if starts:
            own = [(displacement(t / FPS + s), viewmats[i : i + 1]) for i, s in enumerate(starts)]
            shown = np.concatenate([pictures(gaussians, *view, noise, rng) for view in own])
        else:
            shown = pictures(gaussians, displacement(t / FPS), viewmats, noise, rng)
        for i, picture in enumerate(shown):
            Image.fromarray(picture).save(folder / "train" / f"r_{i:03d}.png", compress_level=1)
            c2w = np.linalg.inv(viewmats[i]) @ np.diag([1.0, -1.0, -1.0, 1.0])
            frames.append(
                {"file_path": f"./train/r_{i:03d}", "transform_matrix": c2w.tolist(), "time": t / FPS}
            )
        transforms = {"camera_angle_x": CAMERA_ANGLE_X, "frames": frames}
        (folder / "transforms_train.json").write_text(json.dumps(transforms))
    scene = {"fps": FPS, "unit_scale_m": 0.1} | ({"kind": kind} if kind else {})
    (path / "set" / "scene.json").write_text(json.dumps(scene))
    return path / "set"


def run_of(path, displacement, motion=None, **how):
    """A run with the exact scene at rest on such a dataset; its motion is `motion`, or none at all."""
    dataset = filmed(path, displacement, **how)
    run = Run.create(path / "run", dataset, "modal", {"motion": {"nuisance": "none"}})
    gaussians = model()
    run.save_space(gaussians, {})
    n_timesteps = how.get("n_timesteps", 45)
    run.save_motion(motion or modes({}, n_timesteps), {})
    return run


def modes(phasors, n_timesteps=45):
    """A run's motion from phasors [N, 3] by frequency in Hz."""
    n = sum(PARTS)
    values = np.array([phasors[f] for f in sorted(phasors)], np.complex64).reshape(-1, n, 3)
    return ModalMotion.of_phasors(
        np.array(sorted(phasors), float), values, np.zeros_like(values), FPS, n_timesteps
    )


def sine(hz, amplitude, phase=0.0, decay=0.0):
    """amplitude · exp(−decay t) cos(2π hz t + phase)."""
    along = np.asarray(amplitude, float)
    return lambda t: along * np.exp(-decay * t) * np.cos(2 * np.pi * hz * t + phase)
