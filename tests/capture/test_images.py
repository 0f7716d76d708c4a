"""Pixels: straight alpha, every kind of PNG and JPEG, 16 bits."""

from contextlib import suppress

import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from tg4mm.capture import ImageStack, load_capture, load_images
from tg4mm.core.errors import CaptureError
from tg4mm.core.pictures.decode import decode, image_header

OpenEXR = pytest.importorskip("OpenEXR")

# Linear light and what sRGB makes of it, from the standard's formula worked out by hand.
LINEAR = (0.0, 0.0021404, 0.2140411, 0.5, 1.0)
SRGB = (0.0, 0.0276542, 0.5, 0.7353570, 1.0)

GREY = np.random.default_rng(0).integers(0, 65536, (20, 30), dtype=np.uint16)
COLOUR = np.random.default_rng(1).integers(0, 65536, (20, 30, 3), dtype=np.uint16)
EIGHT = (COLOUR >> 8).astype(np.uint8)


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


def write(path, channels, header=None):
    full = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **(header or {})}
    with OpenEXR.File(full, {k: np.ascontiguousarray(v, np.float32) for k, v in channels.items()}) as file:
        file.write(str(path))
    return path


def rgba(height=8, width=12, seed=0):
    """Premultiplied, random, with clear, opaque and half-clear pixels, and some brighter than white."""
    rng = np.random.default_rng(seed)
    alpha = rng.choice([0.0, 0.25, 0.7, 1.0], (height, width, 1))
    colour = rng.random((height, width, 3)) * 1.2
    return np.concatenate([colour * alpha, alpha], axis=-1).astype(np.float32)


@pytest.mark.parametrize("alpha", [1.0, 0.25])
def test_colours_are_divided_by_alpha_and_encoded(tmp_path, alpha):
    values = np.array([LINEAR]) * alpha
    channels = {**dict.fromkeys("RGB", values), "A": np.full_like(values, alpha)}
    got = decode(write(tmp_path / "a.exr", channels))
    assert got.dtype == np.uint16
    np.testing.assert_allclose(got[0, :, 0] / 65535, SRGB, atol=2e-5)
    np.testing.assert_array_equal(got[..., 1], got[..., 0])
    assert (got[..., 3] == round(alpha * 65535)).all()


def test_too_bright_negative_and_clear_pixels(tmp_path):
    pixels = np.array([[[3.0, -1.0, 0.5, 1.0], [0.2, 0.2, 0.2, 0.0]]], np.float32)
    got = decode(write(tmp_path / "a.exr", {"RGBA": pixels}))
    assert got[0, 0].tolist()[:2] == [65535, 0]
    assert got[0, 1].tolist() == [0, 0, 0, 0]


def test_a_capture_of_exr_images(folder):
    for path in sorted((folder / "train").glob("*.png")):
        path.unlink()
        write(path.with_suffix(".exr"), {"RGBA": rgba(seed=len(path.name))})
    capture = load_capture(folder)  # the file_path in it has no suffix
    assert [path.suffix for path in capture.paths] == [".exr", ".exr"]
    images = load_images(capture)
    assert images.data.dtype == np.uint16
    assert images.rgb(0).max() <= 1.0
    np.testing.assert_array_equal(images.data[0], decode(capture.paths[0]))


@pytest.mark.parametrize(
    ("channels", "header", "message"),
    [
        ({"Z": np.ones((4, 4))}, {}, r"has channels Z; expected R, G, B or Y"),
        ({"diffuse.R": np.ones((4, 4))}, {}, r"has channels diffuse.R; expected"),
        ({"RGB": np.full((4, 4, 3), np.nan)}, {}, r"holds nan; expected finite numbers"),
        ({"RGB": np.full((4, 4, 3), np.inf)}, {}, r"holds inf; expected finite numbers"),
        (
            {"RGB": np.ones((4, 4, 3))},
            {"dataWindow": (np.array([2, 2], np.int32), np.array([5, 5], np.int32)),
             "displayWindow": (np.array([0, 0], np.int32), np.array([9, 9], np.int32))},
            r"its pixels span \[2, 2\] to \[5, 5\], not its whole picture",
        ),
    ],
)  # fmt: skip
def test_what_is_no_picture_is_refused(tmp_path, channels, header, message):
    with pytest.raises(CaptureError, match=message):
        decode(write(tmp_path / "a.exr", channels, header))


@pytest.mark.parametrize(
    ("options", "given", "expected"),
    [
        ({}, GREY, GREY),
        ({"byteorder": ">"}, GREY, GREY),
        ({"photometric": "miniswhite"}, GREY, 65535 - GREY),
        ({"photometric": "rgb"}, COLOUR, COLOUR),
        ({"photometric": "rgb", "compression": "zlib"}, COLOUR, COLOUR),
        ({"photometric": "rgb", "planarconfig": "separate"}, np.moveaxis(COLOUR, -1, 0), COLOUR),
        ({"photometric": "rgb"}, EIGHT, EIGHT),
    ],
)
def test_a_tiff_gives_its_values(tmp_path, options, given, expected):
    tifffile.imwrite(tmp_path / "a.tif", given, **options)
    pixels = decode(tmp_path / "a.tif")
    assert pixels.dtype == given.dtype
    assert image_header(tmp_path / "a.tif").bits == 8 * given.itemsize
    np.testing.assert_array_equal(pixels[..., :3], np.broadcast_to(np.atleast_3d(expected), (20, 30, 3)))
    assert (pixels[..., 3] == np.iinfo(pixels.dtype).max).all()


@pytest.mark.parametrize("name", ["a.webp", "a.tif"])
def test_eight_bits_by_pillow_come_back(tmp_path, name):
    how = {"lossless": True} if name == "a.webp" else {"compression": "tiff_lzw"}
    Image.fromarray(EIGHT).save(tmp_path / name, **how)
    np.testing.assert_array_equal(decode(tmp_path / name)[..., :3], EIGHT)


@pytest.mark.parametrize(
    ("options", "given", "message"),
    [
        ({}, GREY.astype(np.float32), "has colour mode F"),
        ({}, GREY.astype(np.uint32), "has colour mode I"),
        ({"photometric": "minisblack"}, np.stack([GREY] * 3), "holds 3 pictures"),
        (
            {"photometric": "rgb", "extrasamples": ["assocalpha"]},
            np.dstack([COLOUR, GREY]),
            "must be straight",
        ),
    ],
)
def test_what_is_not_read_is_refused_by_name(tmp_path, options, given, message):
    tifffile.imwrite(tmp_path / "a.tif", given, **options)
    with pytest.raises(CaptureError, match=message):
        decode(tmp_path / "a.tif")


def test_a_damaged_one_is_one_line(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", COLOUR, photometric="rgb")
    whole = (tmp_path / "a.tif").read_bytes()
    rng = np.random.default_rng(2)
    for _ in range(300):
        data = bytearray(whole[: rng.integers(8, len(whole) + 1)])
        data[rng.integers(4, min(len(data), 300))] = rng.integers(256)
        (tmp_path / "b.tif").write_bytes(data)
        with suppress(CaptureError):
            decode(tmp_path / "b.tif")


def test_tiles_of_no_height_are_one_line(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", COLOUR, photometric="rgb", tile=(16, 16))
    with tifffile.TiffFile(tmp_path / "a.tif", mode="r+") as file:
        file.pages[0].tags["TileLength"].overwrite(0)
    with pytest.raises(CaptureError, match=r"a\.tif"):
        decode(tmp_path / "a.tif")
