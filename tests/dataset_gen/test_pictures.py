"""Picture files from linear light: PNG of 8 and 16 bits, EXR, on white or clear, read back by other readers."""

import numpy as np
import pytest

from dataset_gen.pictures import PictureFormat, straight, to_display
from tg4mm.capture.pictures import ImageStack
from tg4mm.core.pictures import png
from tg4mm.core.pictures.decode import decode

EVERY = [PictureFormat(i, b) for i in ("png8", "png16", "exr") for b in ("transparent", "white")]


def light(height=20, width=14, seed=0):
    """[H, W, 4] linear and premultiplied: a smooth picture with noise, clear, partly and wholly covered."""
    rng = np.random.default_rng(seed)
    alpha = np.clip(np.linspace(-0.4, 1.6, width), 0, 1)[None, :, None] * np.ones((height, 1, 1))
    colour = np.linspace(0, 0.9, height)[:, None, None] + 0.1 * rng.random((height, width, 3))
    return np.concatenate([colour * alpha, alpha], -1).astype(np.float32)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("smooth", [True, False])
def test_png_comes_back_as_it_was_written(tmp_path, dtype, channels, smooth):
    rng = np.random.default_rng(1)
    top = np.iinfo(dtype).max
    pixels = rng.integers(0, top, (33, 21, channels), endpoint=True).astype(dtype)
    if smooth:
        ramp = np.add.outer(np.arange(33) ** 2, 7 * np.arange(21))[..., None] + 3 * np.arange(channels)
        pixels = (ramp * (top // 255) % top).astype(dtype)
    path = tmp_path / "a.png"
    path.write_bytes(png.encode(pixels))
    got = decode(path)
    assert got.dtype == dtype
    colours = 1 if channels == 1 else 3
    np.testing.assert_array_equal(got[..., :colours], pixels[..., :colours])
    np.testing.assert_array_equal(got[..., 3], pixels[..., 3] if channels == 4 else top)
    assert png.complete(path, 21, 33, (8 * pixels.itemsize, channels))


@pytest.mark.parametrize("form", EVERY, ids=lambda f: f"{f.images}-{f.background}")
def test_a_reader_sees_the_same_picture_in_every_format(form, tmp_path):
    linear = light()
    path = tmp_path / f"a{form.suffix}"
    path.write_bytes(form.encode(linear))
    assert form.complete(path, 14, 20)
    got = ImageStack(decode(path)[None])
    colour, alpha = straight(linear)
    expected = to_display(colour) * alpha[..., None] + 1 - alpha[..., None]
    bound = {"png8": 0.0041, "png16": 5e-5, "exr": 1.1e-3}[form.images]
    np.testing.assert_allclose(got.rgb(0), expected, atol=bound)
    wanted = alpha if form.background == "transparent" else np.ones_like(alpha)
    np.testing.assert_allclose(got.alpha(0), wanted, atol=0.002)


@pytest.mark.parametrize("form", EVERY, ids=lambda f: f"{f.images}-{f.background}")
def test_torn_and_foreign_files_are_not_complete(form, tmp_path):
    whole = form.encode(light())
    path = tmp_path / "a"
    cases = [(whole, True), (b"", False), (b"GIF89a" + whole[6:], False)]
    cases += [(whole[:n], False) for n in (3, 30, len(whole) // 2, len(whole) - 1)]
    for content, good in cases:
        path.write_bytes(content)
        assert form.complete(path, 14, 20) is good
    path.write_bytes(whole)
    assert not form.complete(path, 14, 21)
    assert not form.complete(path, 28, 10)
    assert not form.complete(tmp_path / "absent", 14, 20)
    for other in EVERY:
        same = other == form or (other.images == form.images == "exr")  # an EXR's channels are not looked at
        assert other.complete(path, 14, 20) is same


def test_exr_keeps_linear_light_premultiplied(tmp_path):
    OpenEXR = pytest.importorskip("OpenEXR")
    linear = light() * 3
    linear[..., 3] /= 3
    path = tmp_path / "a.exr"
    path.write_bytes(PictureFormat("exr").encode(linear))
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        assert sorted(channels) == ["A", "B", "G", "R"]
        for i, name in enumerate("RGBA"):
            np.testing.assert_allclose(channels[name].pixels, linear[..., i], rtol=6e-4, atol=1e-7)
