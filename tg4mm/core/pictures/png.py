"""PNG by numpy and zlib: writing, checking, and, with numba, reading of 16 bits (PNG specification, §§ 9 and 11).

Pillow keeps only the high byte of 16 bits, and Blender's own Python lacks it.
"""

import functools
import os
import struct
import threading
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

SIGNATURE = b"\x89PNG\r\n\x1a\n"
HEADER_BYTES = 33  # signature and IHDR
CHANNELS = {0: 1, 2: 3, 4: 2, 6: 4}  # colour type: grey, RGB, grey + alpha, RGBA
COLOUR_TYPES = {count: kind for kind, count in CHANNELS.items()}
_END = b"\x00\x00\x00\x00IEND\xaeB`\x82"
_COMPILING = threading.Lock()
MAX_PIXELS = 2 * 89_478_485  # Pillow's own limit against decompression bombs


@dataclass(frozen=True)
class PngHeader:
    """IHDR."""

    width: int
    height: int
    bits: int
    colour_type: int
    interlaced: bool


def read_header(start: bytes) -> PngHeader | None:
    """IHDR from a file's first bytes; None if they are no PNG's."""
    if len(start) < HEADER_BYTES or not start.startswith(SIGNATURE) or start[12:16] != b"IHDR":
        return None
    width, height, bits, colour_type, _, _, interlace = struct.unpack_from(">IIBBBBB", start, 16)
    return PngHeader(width, height, bits, colour_type, interlace != 0)


def decode(data: bytes) -> np.ndarray:
    """Return [H, W, 4] uint16 RGBA, straight alpha, 65535 where the file has none. ValueError for a damaged file."""
    header = read_header(data[:HEADER_BYTES])
    if header is None or header.bits != 16 or header.colour_type not in CHANNELS:
        raise ValueError("not a 16-bit PNG")
    if header.interlaced:
        raise ValueError("interlaced 16-bit PNG; write it without interlacing")
    if not 0 < header.width * header.height <= MAX_PIXELS:
        raise ValueError(f"{header.width}×{header.height} pixels, more than {MAX_PIXELS}")
    packed, transparent = _chunks(data)
    channels = CHANNELS[header.colour_type]
    stride = 1 + 2 * channels * header.width
    inflater = zlib.decompressobj()
    raw = inflater.decompress(packed, header.height * stride)
    if len(raw) != header.height * stride:
        raise ValueError(f"pixel data is {len(raw)} bytes, expected {header.height * stride}")
    rows = np.frombuffer(raw, np.uint8).reshape(header.height, stride)
    pixels = unfilter(rows[:, 0], rows[:, 1:].reshape(header.height, header.width, 2 * channels))
    return _rgba(pixels.view(">u2").astype(np.uint16), transparent)


def encode(pixels: np.ndarray, level: int = 6, filtered: bool = True) -> bytes:
    """A PNG of [H, W, C] uint8 or uint16 with C = 1, 3 or 4 (straight alpha); row 0 is the top.

    `level`: of compression, 0 to 9; `filtered`: each row by the filter that leaves the smallest numbers, else by none,
    which is quicker. The same pixels give the same bytes with the same zlib; only header and pixels are in the file.
    """
    if pixels.ndim != 3 or pixels.shape[2] not in COLOUR_TYPES or pixels.dtype not in (np.uint8, np.uint16):
        raise ValueError(
            f"pixels are {pixels.dtype} {pixels.shape}, expected uint8 or uint16 (H, W, 1, 3 or 4)"
        )
    (height, width, channels), size = pixels.shape, pixels.dtype.itemsize
    rows = np.ascontiguousarray(pixels.astype(f">u{size}")).view(np.uint8).reshape(height, -1)
    head = struct.pack(">IIBBBBB", width, height, 8 * size, COLOUR_TYPES[channels], 0, 0, 0)
    data = _filtered(rows, channels * size) if filtered else np.pad(rows, ((0, 0), (1, 0))).tobytes()
    # Z_FILTERED: filtered pictures are mostly small numbers, whose matches are by chance.
    strategy = zlib.Z_FILTERED if filtered else zlib.Z_DEFAULT_STRATEGY
    packer = zlib.compressobj(level, zlib.DEFLATED, 15, 9, strategy)
    return SIGNATURE + _chunk(b"IHDR", head) + _chunk(b"IDAT", packer.compress(data) + packer.flush()) + _END


def fewest_channels(pixels: np.ndarray) -> np.ndarray:
    """Pixels [H, W, 3 or 4] without an alpha that is opaque everywhere, and as grey where all channels are alike."""
    if pixels.shape[2] == 4 and (pixels[..., 3] == np.iinfo(pixels.dtype).max).all():
        pixels = pixels[..., :3]
    return pixels[..., :1] if pixels.shape[2] == 3 and (pixels == pixels[..., :1]).all() else pixels


def complete(path: Path, width: int, height: int, kind: tuple[int, int] | None = None) -> bool:
    """Return whether a file is a PNG of this size with an intact end; reads its first and last bytes only.

    `kind`: bits and channels, if they matter.
    """
    try:
        with path.open("rb") as file:
            head = read_header(file.read(HEADER_BYTES))
            file.seek(-len(_END), os.SEEK_END)
            tail = file.read()
    except OSError:
        return False
    if head is None or tail != _END or (head.width, head.height) != (width, height):
        return False
    return kind is None or (head.bits, CHANNELS.get(head.colour_type)) == kind


def sound(path: Path) -> bool:
    """Return whether all checksums of a PNG are correct; reads the whole file."""
    try:
        data = path.read_bytes()
        _chunks(data)
    except (OSError, ValueError):
        return False
    return data.endswith(_END)


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


def unfilter(filters: np.ndarray, filtered: np.ndarray) -> np.ndarray:
    """Undo PNG's row filters: filters [H], filtered [H, W, B] uint8 → [H, W, B] uint8, B bytes a pixel."""
    if filters.max(initial=0) > 4:
        raise ValueError(f"unknown row filter {filters.max()}")
    if filters.max(initial=0) <= 2:
        return _unfilter_by_row(filters, filtered)
    with _COMPILING:  # once for all threads
        by_byte = _compiled()
    return by_byte(filters, filtered)


def _unfilter_by_row(filters: np.ndarray, filtered: np.ndarray) -> np.ndarray:
    """Undo the filters None, Sub and Up, a row at a time."""
    out = filtered.copy()
    for r, kind in enumerate(filters):
        if kind == 1:
            np.cumsum(filtered[r], axis=0, dtype=np.uint8, out=out[r])
        elif kind == 2 and r > 0:
            out[r] += out[r - 1]
    return out


def _unfilter_by_byte(filters: np.ndarray, filtered: np.ndarray) -> np.ndarray:
    """Undo all five filters, a byte at a time, as the specification words it; compiled."""
    height, width, size = filtered.shape
    out = np.zeros((height + 1, width + 1, size), np.int16)  # row 0 and column 0: the zeros outside the image
    for r in range(height):
        kind = filters[r]
        for x in range(width):
            for b in range(size):
                left, up, corner = out[r + 1, x, b], out[r, x + 1, b], out[r, x, b]
                guess = 0
                if kind == 1:
                    guess = left
                elif kind == 2:
                    guess = up
                elif kind == 3:
                    guess = (left + up) >> 1
                elif kind == 4:
                    to_left, to_up, to_corner = (
                        abs(up - corner),
                        abs(left - corner),
                        abs(left + up - 2 * corner),
                    )
                    guess = corner
                    if to_left <= to_up and to_left <= to_corner:
                        guess = left
                    elif to_up <= to_corner:
                        guess = up
                out[r + 1, x + 1, b] = (filtered[r, x, b] + guess) & 255
    return out[1:, 1:].astype(np.uint8)


@functools.cache
def _compiled() -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    import numba

    return numba.njit(nogil=True, cache=True)(_unfilter_by_byte)


def _chunks(data: bytes) -> tuple[bytes, bytes]:
    """The joined IDAT chunks, and tRNS (or b""); ValueError if a chunk is cut off or its CRC is wrong."""
    packed, transparent, at = [], b"", len(SIGNATURE)
    while True:
        if at + 12 > len(data):
            raise ValueError("file is truncated")
        (length,) = struct.unpack_from(">I", data, at)
        if at + 12 + length > len(data):
            raise ValueError("file is truncated")
        kind, body = data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        if zlib.crc32(kind + body) != struct.unpack_from(">I", data, at + 8 + length)[0]:
            raise ValueError(f"chunk {kind!r} has a wrong checksum")
        if kind == b"IDAT":
            packed.append(body)
        elif kind == b"tRNS":
            transparent = body
        elif kind == b"IEND":
            return b"".join(packed), transparent
        at += 12 + length


def _rgba(pixels: np.ndarray, transparent: bytes) -> np.ndarray:
    """[H, W, 1 | 2 | 3 | 4] → [H, W, 4]; `transparent` is tRNS, the clear colour of a file without alpha."""
    channels = pixels.shape[-1]
    rgba = np.full((*pixels.shape[:2], 4), 65535, np.uint16)
    rgba[..., :3] = pixels[..., :3] if channels >= 3 else pixels[..., :1]
    if channels in (2, 4):
        rgba[..., 3] = pixels[..., -1]
    elif len(transparent) == 2 * channels:
        rgba[(pixels == np.frombuffer(transparent, ">u2")).all(axis=-1), 3] = 0
    return rgba
