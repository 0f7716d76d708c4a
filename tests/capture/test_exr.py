"""EXR images: linear and premultiplied in the file, straight sRGB in memory; damaged files are refused."""

import numpy as np
import pytest

from tg4mm.capture import load_capture, load_images
from tg4mm.core.errors import CaptureError
from tg4mm.core.pictures.decode import decode

OpenEXR = pytest.importorskip("OpenEXR")

# Linear light and what sRGB makes of it, from the standard's formula worked out by hand.
LINEAR = (0.0, 0.0021404, 0.2140411, 0.5, 1.0)
SRGB = (0.0, 0.0276542, 0.5, 0.7353570, 1.0)


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
