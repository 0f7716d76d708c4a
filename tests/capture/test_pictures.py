"""Pictures on disk are read as those in memory, and no more often than they must be."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from tests.fit.space.scenes import capture_of
from tests.helpers.motion_temporal import components
from tg4mm.capture import load_images
from tg4mm.capture.pictures import (
    FilePictures,
    MaskedPictures,
    grey_over_white,
    over_white,
    pictures_for,
    read_once,
    some_pictures,
)
from tg4mm.capture.planes import LUMA
from tg4mm.core.errors import CaptureError
from tg4mm.core.pictures.png import encode
from tg4mm.fit.motion.observations import observe

SIZE = (5, 6)  # height, width


@pytest.fixture
def capture(tmp_path):
    """Two cameras, five timesteps."""
    data = np.random.default_rng(0).integers(0, 256, (10, *SIZE, 4)).astype(np.uint8)
    capture, _ = capture_of([0, 1] * 5, [t for t in range(5) for _ in range(2)], data)
    paths = tuple(tmp_path / f"{i}.png" for i in range(10))
    for path, image in zip(paths, data, strict=True):
        Image.fromarray(image).save(path)
    return replace(capture, root=tmp_path, paths=paths)


def with_one_of_16_bits(capture):
    data = np.random.default_rng(1).integers(0, 65536, (*SIZE, 4)).astype(np.uint16)
    capture.paths[3].write_bytes(encode(data))


@pytest.mark.parametrize("bits", [8, 16])
def test_they_are_those_of_the_stack(capture, bits):
    if bits == 16:
        with_one_of_16_bits(capture)
    files, stack = FilePictures(capture), load_images(capture)
    assert (files.size, files.maximum, len(files)) == (SIZE, stack.maximum, 10)
    for i in range(10):
        np.testing.assert_array_equal(files.rgb(i), stack.rgb(i))
        np.testing.assert_array_equal(files.alpha(i), stack.alpha(i))
    rows, strip = [7, 3, 3], slice(1, 3)
    found = files.strips(rows)(strip)
    assert found.dtype == stack.data.dtype
    np.testing.assert_array_equal(found, stack.strips(rows)(strip))


def test_their_components_are_those_of_the_stack(capture):
    found = components(observe(capture, FilePictures(capture)), 16)
    expected = components(observe(capture, load_images(capture)), 16)
    np.testing.assert_array_equal(found.basis, expected.basis)
    np.testing.assert_array_equal(found.images, expected.images)
    np.testing.assert_array_equal(found.residual_energy, expected.residual_energy)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda path: path.unlink(), r"4\.png"),
        (lambda path: path.write_bytes(path.read_bytes()[:60]), r"4\.png: cannot be decoded"),
        (lambda path: Image.new("RGBA", (7, 5)).save(path), r"4\.png: is 7×5 pixels, expected 6×5"),
    ],
)
def test_a_spoiled_file_is_an_error_with_its_name(capture, spoil, message):
    files = FilePictures(capture)
    assert files.maximum == 255
    spoil(capture.paths[4])
    with pytest.raises(CaptureError, match=message):
        components(observe(capture, files), 16)


def test_what_is_masked_stays_as_in_the_first_picture(capture):
    mask = np.zeros(SIZE, bool)
    mask[1:3, 2:5] = True
    plain = load_images(capture)
    masked = MaskedPictures(plain, mask[None], dict.fromkeys((0, 4, 6), 0), (0,))
    assert (masked.size, masked.maximum) == (plain.size, plain.maximum)
    raw, out = plain.strips([0, 4, 6]), masked.strips([0, 4, 6])
    for rows in (slice(None), slice(2, 4)):
        assert (out(rows)[:, mask[rows]] == plain.strips([0])(rows)[0][mask[rows]]).all()
        assert (out(rows)[:, ~mask[rows]] == raw(rows)[:, ~mask[rows]]).all()
    assert not (raw(slice(None))[1][mask] == out(slice(None))[1][mask]).all()


def test_steps_that_follow_one_another_read_a_capture_once(capture, monkeypatch):
    read, rows = [], np.array([7, 2])
    monkeypatch.setattr(
        "tg4mm.capture.pictures.load_images", lambda own: read.append(len(own)) or load_images(own)
    )
    wanted = load_images(capture).data
    with read_once():
        assert pictures_for(capture) is pictures_for(replace(capture))
        np.testing.assert_array_equal(some_pictures(capture, rows).data, wanted[rows])
        assert read == [10]
        with_one_of_16_bits(capture)
        assert pictures_for(capture).data.dtype == np.uint16
        pictures_for(replace(capture, paths=capture.paths[::-1]))
        assert read == [10] * 3
    np.testing.assert_array_equal(some_pictures(capture, rows).data, wanted[rows])
    assert pictures_for(capture) is not pictures_for(capture)
    assert read == [10, 10, 10, 2, 10, 10]


@pytest.mark.parametrize("is_opaque", [True, False])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_colours_and_grey_over_white(is_opaque, dtype):
    """As the formula says, in double precision: to a part in a million of white."""
    most = np.iinfo(dtype).max
    raw = np.random.default_rng(0).integers(0, most + 1, (2, 3, *SIZE, 4)).astype(dtype)
    raw[..., 3] = most if is_opaque else raw[..., 3]
    alpha = raw[..., 3:] / most
    wanted = raw[..., :3] / most * alpha + 1 - alpha
    shown, grey = over_white(raw[:, :, 1:], most), grey_over_white(raw[:, :, 1:], most)
    assert (shown.dtype, grey.dtype) == (np.float32, np.float32)
    np.testing.assert_allclose(shown, wanted[:, :, 1:], atol=1e-6)
    np.testing.assert_allclose(grey, 255 * wanted[:, :, 1:] @ LUMA.astype(float), atol=255e-6)
