"""Points for known cameras lie on the surfaces, repeat, keep to the masks, and give way where there is no texture."""

import numpy as np
import pytest

from tests.capture.sfm.scenes import intrinsics, orbit, picture, surface_distance
from tests.fit.space.scenes import views_of
from tg4mm.capture.sfm import triangulate_views
from tg4mm.capture.sfm.points import outside_masks
from tg4mm.fit.space import initial
from tg4mm.fit.space.initial import initial_points

SIZE = (180, 180)
K = intrinsics(*SIZE, 200.0)
PIXEL = 4 / 200.0  # scene units at the object


def views(n=12, plain=False, floor=True):
    viewmats = orbit(n, turn=np.pi)
    pixels = np.stack([picture(v, K, SIZE, plain=plain, floor=floor) for v in viewmats]) / 255
    alpha = pixels[..., 3]
    return views_of(viewmats, K, alpha, pixels[..., :3] * alpha[..., None] + 1 - alpha[..., None])


@pytest.fixture(scope="module")
def box():
    """The box without its floor, transparent around."""
    return views(floor=False)


@pytest.fixture(scope="module")
def found(box):
    pytest.importorskip("pycolmap")
    return triangulate_views(box)


def test_points_lie_on_the_surface(found):
    distance = surface_distance(found.xyz)
    assert len(found) > 150
    assert np.median(distance) < 0.5 * PIXEL
    assert np.quantile(distance, 0.95) < 3 * PIXEL
    # a shifted cloud would not pass
    assert np.median(surface_distance(found.xyz + [0.05, 0.05, 0.05])) > PIXEL


def test_no_point_is_where_a_picture_shows_background(box, found):
    masks = box.alpha > 0.5
    assert not outside_masks(found.xyz, box.viewmats, box.Ks, masks).any()
    assert outside_masks(found.xyz + [0, 0, 3], box.viewmats, box.Ks, masks).all()


def test_a_second_run_finds_the_same_points(box, found):
    again = triangulate_views(box)
    for name in ("xyz", "rgb", "errors_px", "n_views"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))


class TestStart:
    """space.init=sfm."""

    def test_the_space_stage_starts_from_the_points(self, box):
        pytest.importorskip("pycolmap")
        first = initial_points(box, None, "sfm", 10_000, np.random.default_rng(0))
        assert first.source == f"sfm ({len(first.xyz)} points)"
        assert np.median(surface_distance(first.xyz)) < PIXEL
        few = initial_points(box, None, "sfm", 60, np.random.default_rng(0))
        assert len(few.xyz) == 60

    def test_without_texture_the_hull_takes_over_with_a_warning(self):
        pytest.importorskip("pycolmap")
        plain = views(5, plain=True, floor=False)
        with pytest.warns(
            UserWarning, match=r"structure from motion found \d+ points, fewer than 100: texture"
        ):
            first = initial_points(plain, None, "sfm", 300, np.random.default_rng(0))
        assert first.source.startswith("hull (sfm found ")
        assert len(first.xyz) == initial.FEWEST
