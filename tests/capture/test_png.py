"""16-bit PNG: every colour type and row filter, against an encoder as specified and against ffmpeg."""

import struct
import subprocess
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tg4mm.core.pictures import png
from tg4mm.core.pictures.decode import decode

TYPES = {0: 1, 4: 2, 2: 3, 6: 4}  # colour type → channels
FILTERS = st.lists(st.integers(0, 4), min_size=1, max_size=9)
PIXELS = np.arange(24, dtype=np.uint16).reshape(2, 3, 4) * 999


def predict(kind, left, up, corner):
    """PNG specification, § 9.2: one byte's prediction."""
    if kind == 4:
        p = left + up - corner
        return min((left, up, corner), key=lambda c: (abs(p - c), (left, up, corner).index(c)))
    return (0, left, up, (left + up) // 2, 0)[min(kind, 4)]  # 5 does not exist: written as none


def filtered_rows(pixels, filters):
    """pixels [H, W, channels] uint16, row r with filter filters[r]; a byte at a time, as specified."""
    height, width, channels = pixels.shape
    rows = pixels.astype(">u2").tobytes()
    size, stride = 2 * channels, 2 * channels * width
    raw = bytearray()
    for r in range(height):
        raw.append(filters[r])
        for i in range(stride):
            left = rows[r * stride + i - size] if i >= size else 0
            up = rows[(r - 1) * stride + i] if r else 0
            corner = rows[(r - 1) * stride + i - size] if r and i >= size else 0
            raw.append((rows[r * stride + i] - predict(filters[r], left, up, corner)) & 255)
    return bytes(raw)


def encode(pixels, colour_type, filters, extra=b"", interlace=0):
    """A 16-bit PNG of pixels [H, W, channels] uint16."""
    packed = zlib.compress(filtered_rows(pixels, filters))
    header = struct.pack(">IIBBBBB", pixels.shape[1], pixels.shape[0], 16, colour_type, 0, 0, interlace)
    half = len(packed) // 2  # two IDAT chunks, as real files have many
    data = chunk(b"IDAT", packed[:half]) + chunk(b"IDAT", packed[half:])
    return png.SIGNATURE + chunk(b"IHDR", header) + extra + data + chunk(b"IEND", b"")


def chunk(kind, body):
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def as_rgba(pixels):
    channels = pixels.shape[-1]
    colour = pixels[..., :3] if channels >= 3 else np.repeat(pixels[..., :1], 3, axis=-1)
    alpha = pixels[..., -1:] if channels in (2, 4) else np.full_like(pixels[..., :1], 65535)
    return np.concatenate([colour, alpha], axis=-1)


@settings(deadline=None)
@given(st.sampled_from(sorted(TYPES)), st.integers(1, 9), FILTERS, st.integers(0, 2**32 - 1))
def test_every_colour_type_and_filter(colour_type, width, filters, seed):
    shape = (len(filters), width, TYPES[colour_type])
    pixels = np.random.default_rng(seed).integers(0, 65536, shape).astype(np.uint16)
    got = png.decode(encode(pixels, colour_type, filters))
    assert got.dtype == np.uint16
    np.testing.assert_array_equal(got, as_rgba(pixels))


@pytest.mark.parametrize("unfilter", [png._unfilter_by_byte, png._compiled()])
@settings(deadline=None, max_examples=50)
@given(st.integers(1, 9), FILTERS, st.integers(0, 2**32 - 1))
def test_filters_are_undone_compiled_and_not(unfilter, width, filters, seed):
    high = 4 if seed % 2 else 65536  # small steps, so that Paeth's ties are met
    pixels = np.random.default_rng(seed).integers(0, high, (len(filters), width, 3)).astype(np.uint16)
    raw = np.frombuffer(filtered_rows(pixels, filters), np.uint8).reshape(len(filters), -1)
    got = unfilter(raw[:, 0], raw[:, 1:].reshape(len(filters), width, 6))
    np.testing.assert_array_equal(np.ascontiguousarray(got).view(">u2"), pixels)


@pytest.mark.parametrize("pixel_format", ["rgba64be", "rgb48be", "gray16be", "ya16be"])
@pytest.mark.parametrize("prediction", ["none", "sub", "up", "avg", "paeth", "mixed"])
def test_files_written_by_ffmpeg(tmp_path, pixel_format, prediction):
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="needs the core extra").get_ffmpeg_exe()
    channels = {"rgba64be": 4, "rgb48be": 3, "gray16be": 1, "ya16be": 2}[pixel_format]
    pixels = np.random.default_rng(1).integers(0, 65536, (31, 45, channels)).astype(np.uint16)
    pixels[:16] = np.arange(45)[:, None] * 300  # smooth, so that "mixed" uses several filters
    path = tmp_path / "a.png"
    source = ["-f", "rawvideo", "-pix_fmt", pixel_format, "-s", "45x31", "-i", "-"]
    target = ["-frames:v", "1", "-c:v", "png", "-pred", prediction, str(path)]
    data = pixels.astype(">u2").tobytes()
    subprocess.run([ffmpeg, "-v", "error", *source, *target], input=data, check=True)
    np.testing.assert_array_equal(decode(path), as_rgba(pixels))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda d: d[:-30], "file is truncated"),
        (lambda d: d[:60], "file is truncated"),
        (lambda d: d[:50] + bytes([d[50] ^ 1]) + d[51:], "has a wrong checksum"),
        (lambda d: encode(PIXELS, 6, [0, 5]), "unknown row filter 5"),
        (lambda d: encode(PIXELS, 6, [0, 0], interlace=1), "interlaced"),
        (lambda d: d[:16] + struct.pack(">II", 3, 3) + d[24:], "pixel data is 50 bytes, expected 75"),
        (lambda d: d[:16] + struct.pack(">II", 2**31, 2**31) + d[24:], "more than"),
        (lambda d: d[:8] + bytes(40), "not a 16-bit PNG"),
    ],
)
def test_damage_is_reported(damage, message):
    good = encode(PIXELS, 6, [0, 0])
    np.testing.assert_array_equal(png.decode(good), PIXELS)
    bad = damage(good)
    # so that only the damage is wrong
    fixed = bad[:29] + struct.pack(">I", zlib.crc32(bad[12:29])) + bad[33:]
    with pytest.raises(ValueError, match=message):
        png.decode(fixed)
