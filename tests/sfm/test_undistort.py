"""Pictures through a lens made straight: against COLMAP's own routine, against the truth, with alpha, one size."""

from __future__ import annotations

import numpy as np
import pytest

from tests.sfm.scenes import intrinsics, orbit, picture
from tg4mm.errors import CaptureError
from tg4mm.sfm.undistort import Lens, lenses

pycolmap = pytest.importorskip("pycolmap")
SIZE = (160, 120)
FOCAL = 170.0


def camera(k1: float = 0.12, size: tuple[int, int] = SIZE, model: str = "SIMPLE_RADIAL"):
    width, height = size
    params = {
        "SIMPLE_RADIAL": [FOCAL, width / 2, height / 2, k1],
        "PINHOLE": [FOCAL, FOCAL, width / 2, height / 2],
    }[model]
    return pycolmap.Camera(model=model, width=width, height=height, params=params, camera_id=1)


@pytest.fixture(scope="module")
def bent() -> np.ndarray:
    return picture(orbit(8)[1], intrinsics(*SIZE, FOCAL), SIZE, k1=0.12)


def test_the_same_as_colmaps_own_pictures(bent: np.ndarray) -> None:
    bent = bent.copy()
    bent[..., 3] = 255
    lens = lenses({1: camera()})[1]
    bitmap = pycolmap.Bitmap.from_array(np.ascontiguousarray(bent[..., :3]))
    theirs, pinhole = pycolmap.undistort_image(pycolmap.UndistortCameraOptions(), bitmap, camera())
    assert (pinhole.width, pinhole.height) == lens.size
    np.testing.assert_allclose(pinhole.calibration_matrix(), lens.K)
    difference = np.abs(lens.apply(bent)[..., :3].astype(int) - theirs.to_array().astype(int))
    assert np.quantile(difference, 0.99) <= 2


def test_what_is_straight_comes_out_where_a_pinhole_sees_it(bent: np.ndarray) -> None:
    lens = lenses({1: camera()})[1]
    true = picture(orbit(8)[1], lens.K, lens.size)
    ours = lens.apply(bent)
    both = (true[..., 3] == 255) & (ours[..., 3] == 255)
    assert both.mean() > 0.3
    error = np.abs(true.astype(int) - ours.astype(int))[both].mean()
    unbent = picture(orbit(8)[1], intrinsics(*SIZE, FOCAL), SIZE)[: lens.size[1], : lens.size[0]]
    untouched = np.abs(bent[: lens.size[1], : lens.size[0]].astype(int) - true.astype(int))[both].mean()
    assert unbent.shape == true.shape
    assert error < 0.3 * untouched
    assert np.mean(true[..., 3] != ours[..., 3]) < 0.02


def test_colour_does_not_bleed_in_from_the_transparent() -> None:
    """Red on fully transparent green: half-covered pixels stay red."""
    image = np.zeros((120, 160, 4), np.uint8)
    image[..., 1] = 255
    image[:, 80:] = (255, 0, 0, 255)
    out = lenses({1: camera()})[1].apply(image)
    edge = (out[..., 3] > 30) & (out[..., 3] < 220)
    assert edge.any()
    assert out[edge][:, 0].min() > 240
    assert out[edge][:, 1].max() < 15


def test_sixteen_bits_become_eight(bent: np.ndarray) -> None:
    lens = lenses({1: camera()})[1]
    wide = lens.apply(bent.astype(np.uint16) * 257).astype(int)
    assert np.abs(wide - lens.apply(bent).astype(int)).max() <= 1


def test_a_pinhole_is_left_as_it_is(bent: np.ndarray) -> None:
    lens = lenses({1: camera(model="PINHOLE")})[1]
    assert (lens.source, lens.size) == (None, SIZE)
    np.testing.assert_array_equal(lens.apply(bent), bent)


def test_cameras_get_one_size_and_their_principal_points_move_along() -> None:
    both: dict[int, Lens] = lenses({1: camera(), 2: camera(model="PINHOLE")})
    assert both[1].size == both[2].size
    viewmat = orbit(8)[1]
    sharp = picture(viewmat, intrinsics(*SIZE, FOCAL), SIZE)
    cropped = both[2].apply(sharp)
    true = picture(viewmat, both[2].K, both[2].size)
    assert np.abs(cropped.astype(int) - true.astype(int)).mean() < 0.5


def test_cameras_of_other_sizes_are_refused() -> None:
    with pytest.raises(
        CaptureError, match=r"pictures of .*160×120.*320×240.* pixels, which one dataset cannot hold"
    ):
        lenses({1: camera(model="PINHOLE"), 2: camera(size=(320, 240), model="PINHOLE")})
