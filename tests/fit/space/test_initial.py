"""Where the first Gaussians stand, on silhouettes whose hull is known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.fit.space.scenes import capsule_mask, intrinsics, orbit, views_of
from tg4mm.capture import SurfacePoints
from tg4mm.core.errors import CaptureError
from tg4mm.fit.space import initial
from tg4mm.fit.space.initial import (
    _project,
    hull_points,
    hull_shell,
    initial_points,
    mean_colours,
    working_box,
)

CENTRE, RADIUS = np.array([0.3, -0.2, 0.5]), 0.8
SIZE = 128
GRID = 48  # cells of the hull's box, a third of what training uses


def silhouettes(capsules, n=24, size=SIZE):
    """Views of the union of capsules (ends [2, 3], radius) by n cameras that look at CENTRE."""
    viewmats, K = orbit(n, CENTRE), intrinsics(size)
    masks = [
        np.any([capsule_mask(viewmat, K, size, ends, radius) for ends, radius in capsules], axis=0)
        for viewmat in viewmats
    ]
    return views_of(viewmats, K, np.stack(masks))


@pytest.fixture(scope="module")
def ball():
    return silhouettes([(np.array([CENTRE, CENTRE]), RADIUS)])


@pytest.fixture(scope="module")
def shell(ball):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(initial, "HULL_GRID", GRID)
        return hull_shell(ball)


@pytest.fixture(autouse=True)
def _small_grid(monkeypatch, ball, shell):
    """The ball's shell, which takes a second, is found once for all tests."""
    monkeypatch.setattr(initial, "HULL_GRID", GRID)
    monkeypatch.setattr(initial, "hull_shell", lambda views: shell if views is ball else hull_shell(views))


def rng():
    return np.random.default_rng(0)


class TestHull:
    def test_a_balls_hull_lies_on_the_ball_within_a_cell(self, ball):
        cell = 2 * RADIUS / GRID
        points = hull_points(ball, 4000, rng())
        assert len(points) == 4000
        distance = np.linalg.norm(points - CENTRE, axis=1) - RADIUS
        # a whole diagonal of a cell within, and outside what no silhouette of 24 cuts away
        assert distance.min() > -2 * cell
        assert np.quantile(distance, 0.95) < cell
        assert abs(np.median(distance)) < 0.7 * cell
        # all round: every octant has its eighth
        octant = ((points > CENTRE) * [1, 2, 4]).sum(1)
        assert np.bincount(octant, minlength=8).min() > len(points) / 8 * 0.8

    def test_what_lies_before_few_cameras_is_left_out(self):
        """The box's corner lies before one camera, on its ball's silhouette, and in no other picture."""
        viewmats, K, size, centre = orbit(12, np.zeros(3)), intrinsics(64, angle=0.4), 64, np.zeros(3)
        turn, _ = Rotation.align_vectors(-viewmats[0, 2, :3], np.full(3, -(3**-0.5)))
        viewmats[:, :3, :3] = viewmats[:, :3, :3] @ turn.as_matrix()
        masks = np.stack([capsule_mask(m, K, size, np.array([centre, centre]), 0.5) for m in viewmats])
        views = views_of(viewmats, K, masks)
        _, half = working_box(views)
        corner = np.full((1, 3), 0.95 * half)
        seen = [_project(corner, views, v)[2][0] for v in range(12)]
        assert 0 < sum(seen) < 3
        points = hull_points(views, 4000, rng())
        assert np.linalg.norm(points, axis=1).max() < 0.7

    @pytest.mark.parametrize("value", [1.0, 0.0])
    def test_masks_that_cut_nothing_or_all_give_none(self, value):
        views = views_of(orbit(4, CENTRE), intrinsics(16), np.full((4, 16, 16), value))
        assert hull_points(views, 100, rng()) is None


class TestChoice:
    def test_auto_takes_the_first_that_is_there(self, ball):
        places = rng().uniform(-1, 1, (50, 3)).astype(np.float32)
        given = SurfacePoints(places, np.full((50, 3), 51, np.uint8))
        opaque = views_of(ball.viewmats, intrinsics(16), np.ones((len(ball.viewmats), 16, 16)))
        assert initial_points(ball, given, "auto", 100, rng()).source == "points"
        assert initial_points(ball, None, "auto", 100, rng()).source == "hull"
        assert initial_points(opaque, None, "auto", 100, rng()).source == "random"
        assert initial_points(ball, given, "random", 100, rng()).source == "random"
        assert initial_points(ball, given, "hull", 100, rng()).source == "hull"

    def test_colours_are_the_mean_of_the_pixels_that_see_them(self):
        """One camera sees red, its opposite blue; a point that only one sees has its colour, no one's is grey."""
        viewmats = np.stack([np.eye(4)] * 2)
        viewmats[1, :3, :3] = np.diag([-1.0, 1, -1])  # turned about y: looks back
        viewmats[:, 2, 3] = [4, 4]
        rgb = np.zeros((2, 8, 8, 3))
        rgb[0, ..., 0] = rgb[1, ..., 2] = 1
        views = views_of(viewmats, intrinsics(8), np.ones((2, 8, 8)), rgb)
        xyz = np.array([[0, 0, 0], [0, 0, 20], [50, 0, 0]], float)
        np.testing.assert_allclose(mean_colours(xyz, views), [[0.5, 0, 0.5], [1, 0, 0], [0.5, 0.5, 0.5]])

    @pytest.mark.parametrize(
        ("kind", "match"),
        [
            ("points", "init is 'points', but the dataset has no points3d.ply"),
            ("hull", "init is 'hull', but the images have no alpha mask"),
            ("cloud", "init is 'cloud', expected auto, points, sfm, hull, random"),
        ],
    )
    def test_what_is_not_there_is_refused(self, kind, match):
        opaque = views_of(orbit(4, CENTRE), intrinsics(16), np.ones((4, 16, 16)))
        with pytest.raises(CaptureError, match=match):
            initial_points(opaque, None, kind, 100, rng())
