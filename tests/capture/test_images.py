"""Pixels: straight alpha, every kind of PNG and JPEG, 16 bits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from tg4mm.capture import ImageStack, load_capture, load_images


def stack(*pixels, dtype=np.uint8):
    """A stack of one 1×C image."""
    return ImageStack(np.array([[pixels]], dtype=dtype))


@given(st.tuples(*[st.integers(0, 255)] * 4), st.tuples(*[st.floats(0, 1)] * 3))
def test_straight_alpha_over_a_background(pixel, background):
    one = stack(pixel)
    alpha = pixel[3] / 255
    expected = [c / 255 * alpha + b * (1 - alpha) for c, b in zip(pixel[:3], background, strict=True)]
    got = one.rgb(0, background)
    assert (got.dtype, got.shape) == (np.float32, (1, 1, 3))
    np.testing.assert_allclose(got[0, 0], expected, atol=1e-6)
    np.testing.assert_allclose(one.alpha(0), [[alpha]], atol=1e-6)


@pytest.mark.parametrize(
    ("mode", "colour", "expected"),
    [
        ("RGBA", (10, 20, 30, 40), (10, 20, 30, 40)),
        ("RGB", (10, 20, 30), (10, 20, 30, 255)),
        ("L", 50, (50, 50, 50, 255)),
        ("LA", (50, 60), (50, 50, 50, 60)),
        ("1", 1, (255, 255, 255, 255)),
    ],
)
def test_png_colour_modes(folder, mode, colour, expected):
    for i in range(2):
        Image.new(mode, (12, 8), colour).save(folder / f"train/r_{i:03d}.png")
    images = load_images(load_capture(folder))
    assert images.data.dtype == np.uint8
    assert images.data.reshape(-1, 4).tolist() == [list(expected)] * 2 * 12 * 8


def test_palette_png_with_a_transparent_colour(folder):
    image = Image.new("P", (12, 8), 1)
    image.putpalette([0, 0, 0, 10, 20, 30])
    image.putpixel((3, 2), 0)
    image.save(folder / "train/r_000.png", transparency=0)
    data = load_images(load_capture(folder)).data[0]
    assert data[0, 0].tolist() == [10, 20, 30, 255]
    assert data[2, 3].tolist() == [0, 0, 0, 0]


@pytest.mark.parametrize("mode", ["RGB", "L"])
def test_jpeg(folder, mode):
    (folder / "train/r_000.png").unlink()
    Image.new(mode, (12, 8), 128 if mode == "L" else (128, 128, 128)).save(folder / "train/r_000.jpg")
    data = load_images(load_capture(folder)).data[0]
    assert np.abs(data[..., :3].astype(int) - 128).max() <= 1
    assert (data[..., 3] == 255).all()


def test_sixteen_bit_grey_keeps_its_low_byte_and_widens_the_others(folder):
    values = (np.arange(96, dtype=np.uint16) * 601).reshape(8, 12)
    Image.fromarray(values).save(folder / "train/r_000.png")
    images = load_images(load_capture(folder))
    assert images.data.dtype == np.uint16
    np.testing.assert_array_equal(images.data[0, ..., 0], values)
    assert (images.data[0, ..., 3] == 65535).all()
    assert images.data[1, 0, 0].tolist() == [101 * 257] * 4
    np.testing.assert_allclose(images.alpha(1), 101 / 255, rtol=1e-6)
