"""TIFF and WebP pictures, 8 and 16 bits, as people's programs write them: the values, or a refusal that says why."""

from contextlib import suppress

import numpy as np
import pytest
import tifffile
from PIL import Image

from tg4mm.core.errors import CaptureError
from tg4mm.core.pictures.decode import decode, image_header

GREY = np.random.default_rng(0).integers(0, 65536, (20, 30), dtype=np.uint16)
COLOUR = np.random.default_rng(1).integers(0, 65536, (20, 30, 3), dtype=np.uint16)
EIGHT = (COLOUR >> 8).astype(np.uint8)


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
    np.testing.assert_array_equal(
        pixels[..., :3], expected if expected.ndim == 3 else np.dstack([expected] * 3)
    )
    assert (pixels[..., 3] == np.iinfo(pixels.dtype).max).all()


@pytest.mark.parametrize("name", ["a.webp", "a.tif"])
def test_eight_bits_by_pillow_come_back(tmp_path, name):
    Image.fromarray(EIGHT).save(
        tmp_path / name, **({"lossless": True} if name == "a.webp" else {"compression": "tiff_lzw"})
    )
    np.testing.assert_array_equal(decode(tmp_path / name)[..., :3], EIGHT)


@pytest.mark.parametrize(
    ("options", "given", "message"),
    [
        ({}, GREY.astype(np.float32), "has colour mode F"),
        ({}, GREY.astype(np.uint32), "has colour mode I"),
        ({"photometric": "minisblack"}, np.stack([GREY] * 3), "holds 3 pictures"),
        ({"photometric": "rgb", "extrasamples": ["assocalpha"]}, np.dstack([COLOUR, GREY]), "straight alpha"),
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
