"""Clouds of Gaussians, their views, and the motion problem that they pose: what the motion stage's tests share."""

from contextlib import nullcontext
from dataclasses import dataclass, replace
from unittest import mock

import numpy as np

from tests.fit.rasterize.oracle import make_scene
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import view_jacobian
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.motion.nuisance.projection import nuisances_of
from tg4mm.fit.motion.solver import preconditioner
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.space.view import EPS2D

SCENES = {
    "ordinary": make_scene(0),
    "thin": make_scene(3, scale=(0.005, 0.4)),
    "crowded": make_scene(5, n=120, spread=0.6, scale=(0.03, 0.15)),
}
COLUMNS = {"displacement": slice(0, 3), "rotation": slice(3, 6), "both": slice(0, 6)}
N = 40  # Gaussians of `problem`
FEW = {"MOST": 1, "_LEAST": 5}  # in `preconditioner`: one region of eight patches of those


@dataclass(frozen=True)
class Camera:
    viewmat: np.ndarray
    K: np.ndarray
    low_pass: float = EPS2D


def gaussians_of(scene):
    tensors = (scene.means, scene.quats, scene.scales, scene.opacities, scene.colors)
    return Gaussians(*(t.float() for t in tensors))


def camera_of(scene, c=0):
    return Camera(scene.viewmats[c].float().numpy(), scene.Ks[c].float().numpy())


def view_of(scene, c=0):
    return view_jacobian(gaussians_of(scene), camera_of(scene, c), (scene.width, scene.height))


def motion_of(scene, columns, seed=0):
    motion = np.zeros((len(scene.means), DOF), np.float32)
    draw = np.random.default_rng(seed).normal(size=motion.shape)
    motion[:, columns] = draw[:, columns]
    return motion


def two_cameras():
    """One cloud of 40 Gaussians."""
    scene = make_scene(0, cameras=2)
    return scene, [camera_of(scene, c) for c in (0, 1)]


def problem(ridge=0.1, nuisance=None, mixed=False, supported=False, patches=False):
    """Two cameras look at one cloud; `nuisance`: columns that are projected out; `mixed`: two target images of three
    fields; `supported`: each of these moves some of the Gaussians alone; `patches`: regions are made of patches.
    """
    scene, cameras = two_cameras()
    gaussians, views = gaussians_of(scene), [view_of(scene, c) for c in (0, 1)]
    with mock.patch.multiple(preconditioner, **FEW) if patches else nullcontext():
        out = Problem.of(views, gaussians, MotionConfig(ridge=ridge), "cpu")
    if nuisance is not None:
        active = np.zeros(12, bool)
        active[nuisance] = True
        means = np.stack([v.over_white for v in views])
        out = replace(
            out, nuisances=nuisances_of(views, cameras, scene.means.float().numpy(), active), means=means
        )
    if mixed:
        rng = np.random.default_rng(11)
        out = replace(out, mixing=[rng.normal(size=(2, 3)).astype(np.float32) for _ in views])
    if supported:
        out = replace(out, support=(np.random.default_rng(12).random((3, N)) < 0.6).astype(np.float32))
    return out


def weights_of(p):
    """[V, H, W]: 0.2 to 1."""
    return np.random.default_rng(7).uniform(0.2, 1, (len(p.views), *p.size[::-1])).astype(np.float32)


def operator(p, smoothness=3.0, weighted=False):
    """The operator of all views."""
    p = p.changed(pixel_weights=weights_of(p)) if weighted else p
    return p.on_cpu(p.everything, smoothness)


def draw(o, seed, count=1):
    """θ [count, P, 3]."""
    n = o.preconditioner.levels[-1].start + len(o.preconditioner.coarse_factor)
    return np.random.default_rng(seed).normal(size=(count, n, 3)).astype(np.float32)


def inner(a, b):
    return float((a.astype(np.float64) * b).sum())


def of_amplitudes(amplitudes, freqs, n=50):
    """Each mode moves all Gaussians along x by its amplitude."""
    displacement = np.zeros((len(freqs), n, 3), np.complex64)
    displacement[..., 0] = np.array(amplitudes)[:, None]
    return ModalMotion.of_phasors(np.array(freqs), displacement, np.zeros_like(displacement), 30.0, 30)
