"""Coarse to fine: every iteration has its level, and smaller pictures show the same from the same place."""

import numpy as np
import pytest

from tests.fit.space.scenes import intrinsics, orbit, views_of
from tests.helpers.space_train import psnr_of_test_views
from tg4mm.core.errors import Tg4mmError
from tg4mm.fit.space import SpaceConfig
from tg4mm.fit.space.density import EVERY
from tg4mm.fit.space.levels import check_levels, level_at, levels, sampled
from tg4mm.run.stages import train_space

FULL = (1080, 1920)


@pytest.mark.parametrize("n", [1, 2, 3, 5])
@pytest.mark.parametrize("iterations", [1, 36, 1000, 9561])
def test_every_iteration_has_one_level(n, iterations):
    found = levels(SpaceConfig(iterations=iterations, max_gaussians=1000, levels=n), FULL)
    assert [level.shrink for level in found] == [1 << (n - 1 - i) for i in range(n)]
    assert [found[0].begin, *(level.end for level in found[:-1])] == [level.begin for level in found]
    assert (found[0].begin, found[-1].end) == (0, iterations)
    assert all(level.begin % EVERY == 0 for level in found)
    for i in range(iterations):
        level = level_at(found, i)
        assert level.begin <= i < level.end
    assert [level.max_gaussians for level in found] == [1000 >> (n - 1 - i) for i in range(n)]


@pytest.mark.parametrize(
    ("size", "most", "n", "dssim", "spacing"),
    [
        (FULL, 288_000, 3, 0.0, [1, 2, 3]),
        (FULL, 2_000_000, 3, 0.0, [1, 1, 1]),
        (FULL, 1000, 3, 0.0, [3, 3, 3]),
        (FULL, 288_000, 3, 0.2, [1, 1, 1]),  # structure is compared in all of a picture
        (FULL, 288_000, 1, 0.0, [1]),
        ((540, 960), 72_000, 2, 0.0, [1, 1]),
    ],
)
def test_of_large_pictures_some_one_pixel_for_each_gaussian_is_seen(size, most, n, dssim, spacing):
    config = SpaceConfig(iterations=1200, max_gaussians=most, levels=n, dssim=dssim)
    assert [level.spacing for level in levels(config, size)] == spacing


@pytest.mark.parametrize("turn", range(9))
def test_pixels_that_are_seen_keep_their_place(turn):
    """The picture's own coordinates as colours: a pixel's centre, unprojected, lies on the ray that it lay on."""
    given = views_of(orbit(1, np.zeros(3)), intrinsics(32), np.ones((1, 17, 31)))
    y, x = np.mgrid[:17, :31] + 0.5
    K, picture = sampled(given.Ks[0], np.stack([x, y, x], 2), 3, turn)
    assert picture.shape[:2] == (len(range(turn // 3, 17, 3)), len(range(turn % 3, 31, 3)))
    rows, columns = np.mgrid[: len(picture), : picture.shape[1]] + 0.5
    for axis, own in enumerate((columns, rows)):
        ray = (own - K[axis, 2]) / K[axis, axis]
        expected = (picture[..., axis] - given.Ks[0, axis, 2]) / given.Ks[0, axis, axis]
        np.testing.assert_allclose(ray, expected, atol=1e-6)


def test_levels_that_leave_no_picture_are_refused():
    check_levels(2, (48, 32))
    said = r"\Asetting space.levels is 3: pictures of 48×32 would be 12×8 at the"
    with pytest.raises(Tg4mmError, match=said):
        check_levels(3, (48, 32))


def test_it_fits_from_coarse_to_fine(views, points, data, new_run):
    """With intrinsics of the wrong size it ends below 30 dB; it starts at 24.5."""
    config = SpaceConfig(iterations=500, max_gaussians=1500, levels=2)
    assert psnr_of_test_views(train_space(new_run(), views, points, config), data) > 35.5
