"""Pictures through a lens made straight: against COLMAP's own routine, against the truth, with alpha, one size."""

import numpy as np
import pytest

from tests.capture.sfm.scenes import intrinsics, orbit, picture
from tg4mm.capture.sfm.undistort import Key, Lens, lenses

pycolmap = pytest.importorskip("pycolmap")
SIZE = (160, 120)
FOCAL = 170.0


def camera(k1=0.12, size=SIZE, model="SIMPLE_RADIAL"):
    width, height = size
    params = {
        "SIMPLE_RADIAL": [FOCAL, width / 2, height / 2, k1],
        "PINHOLE": [FOCAL, FOCAL, width / 2, height / 2],
    }[model]
    return pycolmap.Camera(model=model, width=width, height=height, params=params, camera_id=1)


def lens_of(camera, turns=0):
    return lenses({(1, turns): camera})[1, turns]


@pytest.fixture(scope="module")
def bent():
    return picture(orbit(8)[1], intrinsics(*SIZE, FOCAL), SIZE, k1=0.12)


def test_the_same_as_colmaps_own_pictures(bent):
    bent = bent.copy()
    bent[..., 3] = 255
    lens = lens_of(camera())
    bitmap = pycolmap.Bitmap.from_array(np.ascontiguousarray(bent[..., :3]))
    theirs, pinhole = pycolmap.undistort_image(pycolmap.UndistortCameraOptions(), bitmap, camera())
    assert (pinhole.width, pinhole.height) == lens.size
    np.testing.assert_allclose(pinhole.calibration_matrix(), lens.K)
    difference = np.abs(lens.apply(bent)[..., :3].astype(int) - theirs.to_array().astype(int))
    assert np.quantile(difference, 0.99) <= 2


def test_colour_does_not_bleed_in_from_the_transparent():
    """Red on fully transparent green: half-covered pixels stay red."""
    image = np.zeros((120, 160, 4), np.uint8)
    image[..., 1] = 255
    image[:, 80:] = (255, 0, 0, 255)
    out = lens_of(camera()).apply(image)
    edge = (out[..., 3] > 30) & (out[..., 3] < 220)
    assert edge.any()
    assert out[edge][:, 0].min() > 240
    assert out[edge][:, 1].max() < 15


def test_cameras_get_one_size_and_their_principal_points_move_along():
    one, two = (1, 0), (2, 0)
    both: dict[Key, Lens] = lenses({one: camera(), two: camera(model="PINHOLE")})
    assert both[one].size == both[two].size
    viewmat = orbit(8)[1]
    sharp = picture(viewmat, intrinsics(*SIZE, FOCAL), SIZE)
    cropped = both[two].apply(sharp)
    true = picture(viewmat, both[two].K, both[two].size)
    assert np.abs(cropped.astype(int) - true.astype(int)).mean() < 0.5


@pytest.mark.parametrize("turns", [1, 2, 3])
@pytest.mark.parametrize("model", ["SIMPLE_RADIAL", "PINHOLE"])
def test_a_turned_picture_is_what_a_turned_pinhole_sees(turns, model):
    viewmat = orbit(8)[1]
    shown = picture(viewmat, intrinsics(*SIZE, FOCAL), SIZE, k1=0.12 if model == "SIMPLE_RADIAL" else 0.0)
    lens = lens_of(camera(model=model), turns)
    assert (lens.size[0] > lens.size[1]) == (turns == 2)
    assert not lens.keeps
    turned = picture(lens.viewmat(viewmat), lens.K, lens.size)
    error = np.abs(lens.apply(shown).astype(int) - turned).mean()
    assert error < 0.2 * np.abs(lens.apply(shown)[::-1, ::-1].astype(int) - turned).mean()
    if model == "PINHOLE":
        np.testing.assert_array_equal(lens.apply(shown), np.rot90(shown, turns))


@pytest.mark.parametrize(("size", "block"), [((400, 300), 2), ((170, 100), 1), ((90, 300), 1)])
def test_other_pictures_are_scaled_and_cut_to_the_size_of_the_main_ones(size, block):
    width, height = size
    params = [1.1 * max(size), width / 2, height / 2, 0.1]
    other = pycolmap.Camera(model="SIMPLE_RADIAL", width=width, height=height, params=params, camera_id=2)
    found = lenses({(1, 0): camera(model="PINHOLE"), (2, 0): other}, fitted=[(2, 0)])
    assert found[1, 0].keeps
    lens = found[2, 0]
    assert (lens.size, lens.block) == (SIZE, block)
    viewmat = orbit(8)[1]
    shown = picture(viewmat, intrinsics(width, height, params[0]), size, k1=0.1)
    true = picture(viewmat, lens.K, SIZE)
    ours = lens.apply(shown)
    solid = (true[..., 3] == 255) & (ours[..., 3] == 255)
    assert solid.mean() > 0.3
    assert np.abs(ours.astype(int) - true)[solid].mean() < 6
