"""The world given to poses that have none."""

import numpy as np
import pytest

from tests.capture.sfm.scenes import CENTRE, orbit
from tg4mm.capture.cameras import optical_axes
from tg4mm.capture.sfm.points import DISTANCE, Similarity, up_axis, world_of


def rotation(seed=0):
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.linalg.det(q)


def elsewhere(viewmats, seed=0):
    """The same cameras in a world that is turned, shifted and 7 times smaller."""
    return Similarity(rotation(seed), 1 / 7, np.array([3.0, -2.0, 5.0])).viewmats(viewmats)


@pytest.mark.parametrize("seed", range(4))
def test_an_orbit_comes_back_upright_centred_and_four_units_away(seed):
    viewmats = elsewhere(orbit(12), seed)
    world = world_of(viewmats, np.zeros((0, 3)))
    centres, axes = optical_axes(world.viewmats(viewmats))
    elevation = np.arcsin(centres[:, 2] / np.linalg.norm(centres, axis=1))
    true_centres, _ = optical_axes(orbit(12))
    true = np.arcsin((true_centres - CENTRE)[:, 2] / 4)
    np.testing.assert_allclose(elevation, true, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(centres, axis=1).mean(), DISTANCE)
    assert abs(axes[0, 0]) < 1e-9  # the first camera looks along +y
    assert axes[0, 1] > 0
    assert np.linalg.det(world.rotation) == pytest.approx(1)


def test_up_is_across_to_the_pictures_rows_though_cameras_look_down():
    """A quarter of a turn: the mean of the cameras' ups leans by tens of degrees, the rows do not."""
    viewmats = orbit(8, turn=np.pi / 2, low=0.9, high=1.1)
    mean_up = -viewmats[:, 1, :3].mean(0)
    assert mean_up[2] / np.linalg.norm(mean_up) < 0.85
    np.testing.assert_allclose(up_axis(viewmats), [0, 0, 1], atol=1e-9)


def test_parallel_axes_take_the_points_middle():
    viewmats = np.tile(np.eye(4), (3, 1, 1))
    viewmats[:, 0, 3] = range(3)
    xyz = np.array([[0, 0, 8.0], [0, 1, 8], [-1, 0, 8]])
    world = world_of(viewmats, xyz)
    np.testing.assert_allclose(world.centre, [0, 0, 8])


def test_a_camera_straight_above_has_a_direction_too():
    down = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 4], [0, 0, 0, 1]])
    viewmats = np.concatenate([down[None], orbit(6)])
    world = world_of(viewmats, np.zeros((0, 3)))
    assert np.isfinite(world.rotation).all()
    np.testing.assert_allclose(world.rotation @ world.rotation.T, np.eye(3), atol=1e-9)
