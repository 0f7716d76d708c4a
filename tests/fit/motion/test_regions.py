"""A region's shift in the pictures is the one that it moved by, and its noise that of the pictures."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.fit.motion.filmed import K_of
from tests.fit.motion.scenes import Camera
from tests.helpers.synthetic import _gaussians, _parts, _viewmats
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import ViewJacobian, view_jacobian
from tg4mm.fit.motion.nuisance.projection import Projection, nuisances_of
from tg4mm.fit.motion.observation_model import ObservationModel
from tg4mm.fit.motion.observations import PosedFrames
from tg4mm.fit.motion.spectrum import sinusoids
from tg4mm.fit.motion.temporal.steady import moving_camera_series, shift_series

SIZE, POST = 64, 1


class Scene:
    """Floor, post and ball, each a region, before one camera."""

    def __init__(self):
        parts = _parts(1)
        self.gaussians = _gaussians(parts, 1)
        self.labels = np.repeat(np.arange(3), [len(p.vertices) for p in parts])
        self.camera = Camera(_viewmats(5, 0.0)[1].astype(np.float32), K_of(SIZE))
        self.view: ViewJacobian = view_jacobian(self.gaussians, self.camera, (SIZE, SIZE))

    @property
    def axes(self):
        return self.camera.viewmat[:2, :3]

    def shown(self, shifts, region=POST):
        """[F, H, W, 3]: what a region's shifts [F, 2] to the right and down, in scene units, change."""
        motions = np.zeros((len(shifts), len(self.labels), DOF), np.float32)
        motions[:, self.labels == region, :3] = (shifts @ self.axes)[:, None]
        return self.view.jvp(motions)

    def model(self, times_s, projection=None):
        frames = PosedFrames("", self.camera.viewmat, self.camera.K, np.arange(len(times_s)), times_s)
        return ObservationModel(frames, self.view, projection)

    def series(self, changes, projection=None):
        model = self.model(np.arange(len(changes)) / 30, projection)
        by_three = (changes[k : k + 3] for k in range(0, len(changes), 3))
        return shift_series(model, self.labels, by_three)


@pytest.fixture(scope="module")
def scene():
    return Scene()


def shifts_of(series):
    """[F, G, 2] scene units."""
    return np.linalg.solve(
        np.broadcast_to(series.normals, (*series.sides.shape, 2)), series.sides[..., None]
    )[..., 0]


SHIFTS = 0.01 * np.random.default_rng(0).normal(size=(7, 2))


@pytest.mark.parametrize("region", [0, 1, 2], ids=["floor", "post", "ball"])
def test_a_regions_shift_comes_out(scene, region):
    """And of those that stand still a little, where pixels show two of them."""
    found = shifts_of(scene.series(scene.shown(SHIFTS, region)))
    size = np.linalg.norm(SHIFTS)
    assert found.shape == (7, 3, 2)
    assert np.linalg.norm(found[:, region] - SHIFTS) < 0.1 * size
    others = [k for k in range(3) if k != region]
    assert np.linalg.norm(found[:, others]) < 0.4 * size


def test_what_nuisance_does_shifts_nothing(scene):
    """Exposure that varies by all of it, beside the shift: as without, if it is projected out."""
    active = np.arange(12) < 6
    (nuisance,) = nuisances_of([scene.view], [scene.camera], scene.gaussians.means.numpy(), active)
    mean = scene.view.over_white
    projection = Projection.of(nuisance, mean, None)
    drift = np.random.default_rng(1).normal(size=(7, 1, 1, 1))
    changes = (scene.shown(SHIFTS) + drift * mean).astype(np.float32)
    size = np.linalg.norm(SHIFTS)
    clean, taken_out = (
        shifts_of(scene.series(c, projection))[:, POST] for c in (scene.shown(SHIFTS), changes)
    )
    assert np.linalg.norm(taken_out - clean) < 0.01 * size
    assert np.linalg.norm(clean - SHIFTS) < 0.15 * size
    assert np.linalg.norm(shifts_of(scene.series(changes))[:, POST] - SHIFTS) > 0.3 * size


def test_a_region_that_is_not_seen_says_nothing(scene):
    """Ten Gaussians of the floor behind the camera."""
    unseen = Scene()
    means, behind = unseen.gaussians.means.clone(), np.arange(10)
    means[behind] -= torch.from_numpy(10 * unseen.camera.viewmat[2, :3])
    unseen.gaussians = replace(unseen.gaussians, means=means)
    unseen.view = view_jacobian(unseen.gaussians, unseen.camera, (SIZE, SIZE))
    unseen.labels = unseen.labels.copy()
    unseen.labels[behind] = 3
    noise = np.random.default_rng(2).normal(size=(5, SIZE, SIZE, 3)).astype(np.float32)
    whitened = unseen.series(noise).whitened().reshape(5, 4, 2)
    assert not whitened[:, 3].any()
    assert whitened[:, :3].any()


def test_phasors_are_those_of_the_shifts(scene):
    """With a drift beside them, too."""
    t, hz = np.arange(40) / 30, np.array([3.3, 7.9])
    phasors = np.array([[0.01 + 0.02j, -0.01j], [0.005, 0.01 - 0.004j]])  # [K, 2]
    swing = (phasors[:, None] * np.exp(2j * np.pi * hz[:, None] * t)[..., None]).real.sum(0)
    series = scene.series(scene.shown(swing + np.outer(t, [0.02, -0.01])))
    found = np.linalg.solve(series.normals, series.phasors(sinusoids(t, hz))[..., None])[:, POST, :, 0]
    assert np.linalg.norm(found - phasors) < 0.1 * np.linalg.norm(phasors)


def test_a_camera_that_moves_by_nothing_is_a_fixed_one(scene):
    changes = scene.shown(SHIFTS)
    fixed = scene.series(changes)
    n = len(changes)
    models = [scene.model(fixed.times_s[k : k + 1]) for k in range(n)]
    moving = moving_camera_series(models, iter(changes), scene.labels)
    np.testing.assert_array_equal(moving.times_s, fixed.times_s)
    np.testing.assert_allclose(moving.sides, fixed.sides, atol=1e-4 * np.abs(fixed.sides).max())
    for k in range(n):
        np.testing.assert_allclose(moving.normals[k], fixed.normals[0], rtol=1e-4)
        np.testing.assert_allclose(moving.axes[k], fixed.axes[0])
