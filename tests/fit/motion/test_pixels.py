"""How far a motion moves the Gaussians in the pictures."""

import numpy as np
import pytest

from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.capture import load_capture
from tg4mm.fit.motion.jacobian.pixels import pixels_moved
from tg4mm.fit.motion.jacobian.view import view_jacobian
from tg4mm.fit.motion.observations import fixed_cameras


@pytest.fixture(scope="module")
def posed(tmp_path_factory):
    root = tmp_path_factory.mktemp("pixels")
    gaussians, _ = make_synthetic_dataset(root, n_views=2, n_timesteps=2, size=32, alphas=(), n_test=0)
    cameras = fixed_cameras(load_capture(root))
    return [view_jacobian(gaussians, camera, (32, 32)) for camera in cameras], gaussians, cameras


def test_a_small_part_that_moves_far_is_not_missed(posed):
    """Three of a hundred Gaussians in view."""
    views, gaussians, cameras = posed
    view = views[0]
    seen = view.bins.order[: view.bins.n_visible]
    shift = np.zeros((len(gaussians), 3))
    shift[seen[::33]] = 0.1 * cameras[0].viewmat[0, :3]
    assert pixels_moved([view], shift[None]) > 0.4


@pytest.mark.parametrize("axis", [0, 1, 2], ids=["right", "down", "along the sight"])
def test_pixels_are_those_between_two_projections(posed, axis):
    """Each Gaussian by another length, along one axis of the camera."""
    views, gaussians, cameras = posed
    view, camera = views[0], cameras[0]
    lengths = np.random.default_rng(axis).uniform(0, 0.02, (len(gaussians), 1))
    shift = (lengths * camera.viewmat[axis, :3]).astype(np.float32)
    seen = view.bins.order[: view.bins.n_visible]
    means = gaussians.means.numpy().astype(np.float64)[seen]
    before, after = _projected(camera, means), _projected(camera, means + shift[seen])
    expected = np.percentile(np.linalg.norm(after - before, axis=1), 99)
    assert pixels_moved([view], shift[None]) == pytest.approx(expected, rel=0.01)


def _projected(camera, points):
    """Pixels [n, 2]."""
    at = np.hstack([points, np.ones((len(points), 1))]) @ camera.viewmat[:3].T @ camera.K.T
    return at[:, :2] / at[:, 2:]
