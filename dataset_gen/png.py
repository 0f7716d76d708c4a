"""PNG files: written from arrays without Blender, checked for completeness."""

import os
import struct
import zlib
from pathlib import Path

import numpy as np

_HEAD = b"\x89PNG\r\n\x1a\n"
_TAIL = b"IEND\xaeB`\x82"
_COLOUR_TYPE = {1: 0, 3: 2, 4: 6}  # channels: grey, RGB, RGBA
_LEVEL = 6  # of zlib


def encode(pixels: np.ndarray) -> bytes:
    """A PNG of [H, W, C] uint8 or uint16 with C = 1, 3 or 4 (straight alpha); row 0 is the top.

    The same pixels give the same bytes with the same zlib; nothing but header and pixels is in the file.
    """
    if pixels.ndim != 3 or pixels.shape[2] not in _COLOUR_TYPE or pixels.dtype not in (np.uint8, np.uint16):
        raise ValueError(
            f"pixels are {pixels.dtype} {pixels.shape}, expected uint8 or uint16 (H, W, 1, 3 or 4)"
        )
    height, width, channels = pixels.shape
    bits = 8 * pixels.dtype.itemsize
    rows = np.ascontiguousarray(pixels.astype(f">u{bits // 8}")).view(np.uint8).reshape(height, -1)
    head = struct.pack(">IIBBBBB", width, height, bits, _COLOUR_TYPE[channels], 0, 0, 0)
    # Z_FILTERED: filtered pictures are mostly small numbers, whose matches are by chance.
    packer = zlib.compressobj(_LEVEL, zlib.DEFLATED, 15, 9, zlib.Z_FILTERED)
    packed = packer.compress(_filtered(rows, channels * bits // 8)) + packer.flush()
    return _HEAD + _chunk(b"IHDR", head) + _chunk(b"IDAT", packed) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def _filtered(rows: np.ndarray, size: int) -> bytes:
    """Rows [H, W · size] uint8 with the filter in front that leaves each the smallest (PNG spec., § 9).

    The usual measure of small: the sum of the filtered bytes taken as signed numbers.
    """
    now = rows.astype(np.int16)
    up = np.vstack([np.zeros_like(now[:1]), now[:-1]])
    left = np.hstack([np.zeros_like(now[:, :size]), now[:, :-size]])
    corner = np.hstack([np.zeros_like(up[:, :size]), up[:, :-size]])
    to_left, to_up, to_corner = np.abs(up - corner), np.abs(left - corner), np.abs(left + up - 2 * corner)
    nearest = np.where(to_up <= to_corner, up, corner)
    paeth = np.where((to_left <= to_up) & (to_left <= to_corner), left, nearest)
    best = cost = None
    for kind, guess in enumerate((np.int16(0), left, up, (left + up) >> 1, paeth)):
        bytes_ = ((now - guess) & 255).astype(np.uint8)
        marked = np.hstack([np.full((len(rows), 1), kind, np.uint8), bytes_])
        sums = np.abs(bytes_.view(np.int8).astype(np.int32)).sum(1)
        if best is None or cost is None:
            best, cost = marked, sums
        else:
            best = np.where((sums < cost)[:, None], marked, best)
            cost = np.minimum(sums, cost)
    assert best is not None
    return best.tobytes()


def complete(path: Path, width: int, height: int, bits: int = 8, channels: int = 4) -> bool:
    """True for a PNG of this kind and size that ends as PNGs do; reads its first and last bytes only."""
    try:
        with path.open("rb") as file:
            head = file.read(26)
            file.seek(-len(_TAIL), os.SEEK_END)
            tail = file.read()
    except OSError:
        return False
    expected = struct.pack(">I4sIIBB", 13, b"IHDR", width, height, bits, _COLOUR_TYPE[channels])
    return head == _HEAD + expected and tail == _TAIL


def sound(path: Path) -> bool:
    """Return whether all checksums of a PNG are correct; reads the whole file."""
    try:
        data = path.read_bytes()
    except OSError:
        return False
    at = len(_HEAD)
    while at + 12 <= len(data):
        (size,) = struct.unpack_from(">I", data, at)
        body, end = data[at + 4 : at + 8 + size], at + 12 + size
        if end > len(data) or struct.unpack_from(">I", data, end - 4)[0] != zlib.crc32(body):
            return False
        at = end
    return at == len(data)
