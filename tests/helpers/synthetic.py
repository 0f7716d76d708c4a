"""A tiny true dataset made from Gaussians with known modal motion: what trains and reports are tested on.

A textured floor stands still, a post on it sways (bending), a ball beside it moves to and fro. Gaussians sit
on the vertices of closed-form meshes, so the ground truth on disk is exact for them. Pictures are rendered by
`tg4mm.fit.rasterize`; displacements are computed here, not by the code under test.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.run import Run

CAMERA_ANGLE_X = 0.6911112070083618  # radians, NeRF-synthetic's
RADIUS = 4.0  # scene units, camera to the point looked at
CENTRE = np.array([0.0, 0.0, 0.5])


@dataclass(frozen=True)
class _Part:
    name: str
    vertices: np.ndarray  # [V, 3]
    faces: np.ndarray  # [F, 3]
    colours: np.ndarray  # [V, 3] in 0..1
    shape: np.ndarray  # [V, 3] real mode shape of unit amplitude
    frequency: int  # index into the frequencies, -1 = static


def make_synthetic_dataset(
    path: Path,
    n_views: int = 8,
    n_timesteps: int = 10,
    size: int = 48,
    freqs: tuple[float, ...] = (3.0,),
    amplitude: float = 0.02,
    fps: float = 30.0,
    alphas: tuple[int, ...] = (5, 20),
    n_test: int = 2,
    detail: int = 1,
) -> tuple[Gaussians, ModalMotion]:
    """Write a dataset tree (docs/conventions.md) of `size`×`size` pictures; returns the exact model of it.

    `freqs` in Hz: the post sways at the first, the ball at the last. `amplitude` in scene units. `detail`
    multiplies the number of Gaussians along each direction. Displacements are zero at timestep 0.
    """
    parts = _parts(detail)
    gaussians = _gaussians(parts, detail)
    motion = _motion(parts, freqs, amplitude, fps, n_timesteps)
    splits = {"train": _viewmats(n_views, 0.0), "test": _viewmats(n_test, 0.37)}
    for t in range(n_timesteps):
        moment = _at(gaussians, motion, t, 0)
        for split, viewmats in splits.items():
            if len(viewmats):
                _write_split(path / f"{t:03d}", split, moment, viewmats, size, t / fps)
        for alpha in alphas if n_test else ():
            folder = path / "magnified" / f"x{alpha:03d}" / f"{t:03d}"
            _write_split(folder, "test", _at(gaussians, motion, t, alpha), splits["test"], size, t / fps)
    _write_truth(path, parts, motion)
    _write_points(path, parts)
    scene = _scene(path.name, freqs, amplitude, fps, n_timesteps, alphas, size, n_views, n_test)
    (path / "scene.json").write_text(json.dumps(scene, indent=1))
    return gaussians, motion


def exact_run(root: Path, **settings: Any) -> tuple[Run, ModalMotion]:
    """ROOT/run of a new ROOT/data (`make_synthetic_dataset`), its scene at rest exact; and the exact motion."""
    gaussians, motion = make_synthetic_dataset(root / "data", **{"alphas": (), "n_test": 0} | settings)
    run = Run.create(root / "run", root / "data", "modal", {})
    run.save_space(gaussians, {})
    return run, motion


def moving_run(root: Path, **settings: Any) -> Run:
    """`exact_run` with its motion."""
    run, motion = exact_run(root, **settings)
    run.save_motion(motion, {})
    return run


def _parts(detail: int) -> list[_Part]:
    n = 14 * detail
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n)))
    floor = np.stack([x, y, np.zeros_like(x)], 1)
    checker = ((np.floor(x * 3) + np.floor(y * 3)) % 2)[:, None]
    floor_colours = checker * [0.86, 0.84, 0.78] + (1 - checker) * [0.45, 0.55, 0.62]

    post, post_faces = _tube(14 * detail, 24 * detail, lambda v: 0.13 + 0 * v, lambda v: 1.3 * v)
    post = post + [-0.35, 0.0, 0.02]
    height = post[:, 2] / 1.3
    stripes = (np.floor(height * 9) % 2)[:, None]
    post_colours = stripes * [0.80, 0.25, 0.18] + (1 - stripes) * [0.97, 0.93, 0.88]
    sway = height[:, None] ** 2 * np.array([0.0, 1.0, 0.0])

    across, up = lambda v: 0.3 * np.sin(math.pi * v), lambda v: 0.35 - 0.3 * np.cos(math.pi * v)
    ball, ball_faces = _tube(18 * detail, 14 * detail, across, up)
    wedge = (np.floor(np.arctan2(ball[:, 1], ball[:, 0]) / math.pi * 4) % 2)[:, None]
    ball_colours = wedge * [0.16, 0.42, 0.70] + (1 - wedge) * [0.95, 0.80, 0.30]
    slide = np.ones((len(ball), 1)) * np.array([0.8, 0.0, 0.6])
    return [
        _Part("floor", floor, _grid_faces(n, n, False), floor_colours, np.zeros_like(floor), -1),
        _Part("post", post, post_faces, post_colours, sway, 0),
        _Part("ball", ball + [0.5, 0.1, 0.02], ball_faces, ball_colours, slide, 1),
    ]


def _tube(around: int, along: int, radius, height) -> tuple[np.ndarray, np.ndarray]:
    """A surface of revolution about z: `radius(v)` and `height(v)` for v in 0..1."""
    v, u = (a.ravel() for a in np.meshgrid(np.linspace(0.02, 0.98, along), np.arange(around), indexing="ij"))
    angle = 2 * math.pi * u / around
    vertices = np.stack([radius(v) * np.cos(angle), radius(v) * np.sin(angle), height(v)], 1)
    return vertices, _grid_faces(along, around, True)


def _grid_faces(rows: int, columns: int, closed: bool) -> np.ndarray:
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns - (0 if closed else 1)), indexing="ij")
    i, j = i.ravel(), j.ravel()
    right = (j + 1) % columns
    a, b, c, d = i * columns + j, i * columns + right, (i + 1) * columns + right, (i + 1) * columns + j
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)


def _gaussians(parts: list[_Part], detail: int) -> Gaussians:
    means = np.concatenate([part.vertices for part in parts])
    colours = np.concatenate([part.colours for part in parts])
    spread = {"floor": 0.085, "post": 0.034, "ball": 0.048}
    scales = np.concatenate([np.full((len(p.vertices), 3), spread[p.name] / detail) for p in parts])
    scales[: len(parts[0].vertices), 2] = 0.01  # the floor is flat
    quats = np.tile([1.0, 0.0, 0.0, 0.0], (len(means), 1))
    sh = ((colours - 0.5) / 0.28209479177387814)[:, None]
    arrays = [means, quats, scales, np.full(len(means), 0.92), sh]
    return Gaussians(*(torch.as_tensor(a, dtype=torch.float32) for a in arrays))


def _motion(
    parts: list[_Part], freqs: tuple[float, ...], amplitude: float, fps: float, n_timesteps: int
) -> ModalMotion:
    displacement = np.concatenate(_modes(parts, freqs, amplitude), axis=1)
    return ModalMotion.of_phasors(
        np.asarray(freqs, float), displacement, np.zeros_like(displacement), fps, n_timesteps
    )


def with_phasors(motion, displacement=None, rotation=None, freqs_hz=None):
    """The motion with other phasors [K, N, 3], or of other frequencies."""
    return ModalMotion.of_phasors(
        motion.freqs_hz if freqs_hz is None else freqs_hz,
        motion.displacement if displacement is None else displacement,
        motion.rotation if rotation is None else rotation,
        motion.fps,
        motion.n_timesteps,
        motion.gains,
        motion.magnified,
        motion.appearance,
    )


def _modes(parts: list[_Part], freqs: tuple[float, ...], amplitude: float) -> list[np.ndarray]:
    modes = []
    for part in parts:
        mode = np.zeros((len(freqs), *part.vertices.shape), np.complex64)
        if part.frequency >= 0:  # sine phase: zero at timestep 0
            mode[min(part.frequency, len(freqs) - 1)] = -1j * amplitude * part.shape
        modes.append(mode)
    return modes


def _at(gaussians: Gaussians, motion: ModalMotion, t: int, alpha: float) -> Gaussians:
    turn = np.exp(2j * np.pi * motion.freqs_hz * t / motion.fps)
    shift = (1 + alpha) * np.einsum("k,knc->nc", turn, motion.displacement).real
    means = gaussians.means + torch.as_tensor(shift, dtype=torch.float32)
    return Gaussians(means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh)


def _viewmats(n: int, offset: float) -> list[np.ndarray]:
    viewmats = []
    for i in range(n):
        azimuth = 2 * math.pi * (i + offset) / max(n, 1)
        elevation = math.radians(20 + 30 * ((i * 0.618 + offset) % 1))
        flat = math.cos(elevation)
        arm = [math.cos(azimuth) * flat, math.sin(azimuth) * flat, math.sin(elevation)]
        position = CENTRE + RADIUS * np.array(arm)
        z = (CENTRE - position) / RADIUS
        x = np.cross(z, [0, 0, 1.0])
        x /= np.linalg.norm(x)
        viewmat = np.eye(4)
        viewmat[:3, :3] = np.stack([x, np.cross(z, x), z])
        viewmat[:3, 3] = -viewmat[:3, :3] @ position
        viewmats.append(viewmat)
    return viewmats


@torch.no_grad()
def _write_split(
    folder: Path, split: str, gaussians: Gaussians, viewmats: list[np.ndarray], size: int, seconds: float
) -> None:
    from tg4mm.fit.rasterize import rasterization

    focal = size / (2 * math.tan(CAMERA_ANGLE_X / 2))
    K = torch.tensor([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1.0]])
    g = gaussians
    views = torch.as_tensor(np.stack(viewmats), dtype=torch.float32)
    splats, cameras = (g.means, g.quats, g.scales, g.opacities, g.sh), (views, K.expand(len(views), 3, 3))
    rgb, alpha, _ = rasterization(*splats, *cameras, size, size, sh_degree=0)
    straight = torch.cat([rgb / alpha.clamp_min(1e-6), alpha], -1).clamp(0, 1)
    pictures = (straight.numpy() * 255 + 0.5).astype(np.uint8)
    (folder / split).mkdir(parents=True, exist_ok=True)
    frames = []
    for i, (picture, viewmat) in enumerate(zip(pictures, viewmats, strict=True)):
        Image.fromarray(picture).save(folder / split / f"r_{i:03d}.png")
        c2w = np.linalg.inv(viewmat) @ np.diag([1.0, -1.0, -1.0, 1.0])
        frames.append(
            {"file_path": f"./{split}/r_{i:03d}", "transform_matrix": c2w.tolist(), "time": seconds}
        )
    transforms = {"camera_angle_x": CAMERA_ANGLE_X, "frames": frames}
    (folder / f"transforms_{split}.json").write_text(json.dumps(transforms))


def _write_truth(path: Path, parts: list[_Part], motion: ModalMotion) -> None:
    arrays: dict[str, np.ndarray] = {
        "objects": np.array([part.name for part in parts]),
        "frequencies_hz": motion.freqs_hz,
    }
    first = 0
    for i, part in enumerate(parts):
        last = first + len(part.vertices)
        arrays[f"rest_{i}"] = part.vertices.astype(np.float32)
        arrays[f"faces_{i}"] = part.faces
        arrays[f"mode_{i}"] = motion.displacement[:, first:last]
        first = last
    (path / "truth").mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path / "truth" / "motion.npz", **arrays)


def _write_points(path: Path, parts: list[_Part]) -> None:
    from plyfile import PlyData, PlyElement

    xyz = np.concatenate([part.vertices for part in parts])
    rgb = (np.concatenate([part.colours for part in parts]) * 255).astype(np.uint8)
    rows = np.zeros(
        len(xyz), [("x", "f4"), ("y", "f4"), ("z", "f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")]
    )
    for i, names in enumerate((("x", "red"), ("y", "green"), ("z", "blue"))):
        rows[names[0]], rows[names[1]] = xyz[:, i], rgb[:, i]
    PlyData([PlyElement.describe(rows, "vertex")]).write(str(path / "points3d.ply"))


def _scene(name, freqs, amplitude, fps, n_timesteps, alphas, size, n_views, n_test) -> dict:
    modes = [
        {"name": label, "frequency_hz": f, "amplitude": amplitude, "kind": kind}
        for label, f, kind in (("post", freqs[0], "bending"), ("ball", freqs[-1], "translation"))
    ]
    return {
        "format_version": 1,
        "scene": name,
        "fps": fps,
        "n_timesteps": n_timesteps,
        "frequency_hz": freqs[0],
        "amplitude": amplitude,
        "unit_scale_m": 0.1,
        "modes": modes,
        "seed": 0,
        "engine": {"name": "tests/helpers/synthetic.py"},
        "alphas": list(alphas) if n_test else [],
        "background": "transparent",
        "width": size,
        "height": size,
        "blender_version": None,
        "package_version": "0.1.0",
        "n_train": n_views,
        "n_test": n_test,
    }


if __name__ == "__main__":  # python -m tests.helpers.synthetic FOLDER
    import sys

    make_synthetic_dataset(Path(sys.argv[1]))
