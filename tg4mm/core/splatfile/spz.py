"""SPZ: read in version 1 to 3 (gzip) and 4 (zstd, where a module for it is there), written as version 3.

The layout is that of the reference library (github.com/nianticlabs/spz): x right, Y up, z backwards, unless an
extension names other axes. What is read is turned to Z up.
"""

import gzip
import itertools
import math
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from tg4mm.core.splatfile.formula import TURN, transformed, y_up
from tg4mm.core.splatfile.model import ANTIALIASED, Head, drawable
from tg4mm.core.splatfile.ply import replacing

from ..errors import SplatFileError
from ..untrusted import DEFLATE
from .model import SplatFile, log_scale
from .supersplat import largest_put_in

GZIP, NGSP = b"\x1f\x8b", b"NGSP"
_HEAD, _HEAD_4 = struct.Struct("<IIIBBBB"), struct.Struct("<IIIBBBBI12x")
_ANTIALIASED = 1  # a flag
_EXTENSIONS, _MOST_EXTENSIONS = 2, 1 << 20  # a flag; bytes after the Gaussians that are looked at
_ZSTD = 1 << 17  # bytes, at most, that one byte packed by zstd stands for: a block of one value
_AXES = 0xADBE0003  # the extension that names the axes, one of these, right left up down back front
_SYSTEMS = tuple(x + rest for rest in ("DB", "UB", "DF", "UF", "FD", "FU", "BD", "BU") for x in "LR")
_TOWARDS = {"R": (1, 0, 0), "L": (-1, 0, 0), "U": (0, 1, 0), "D": (0, -1, 0), "B": (0, 0, 1), "F": (0, 0, -1)}
_MOST_BITS = 23  # after the binary point; a position has 24 with its sign
_LARGEST = 2**23 - 1  # what a position of 24 bits holds
COLOUR = 0.15  # of the range of a byte, for a change of 1 in f_dc
_LEVEL = 6  # of compression
MAGIC, _VERSION = 0x5053474E, 3


@dataclass(frozen=True)
class _Header:
    version: int
    count: int
    degree: int
    bits: int  # of a position after the binary point
    flags: int

    @property
    def sizes(self) -> list[int]:
        """Bytes of positions, opacities, colours, scales, rotations, further coefficients."""
        each = (
            6 if self.version == 1 else 9,
            1,
            3,
            3,
            4 if self.version > 2 else 3,
            3 * ((self.degree + 1) ** 2 - 1),
        )
        return [self.count * size for size in each]


def head_of_spz(file: BinaryIO) -> Head:
    """Return the file's header."""
    start = file.read(1 << 16)
    raw = start if start.startswith(NGSP) else _unpacked(zlib.decompressobj(31), start, _HEAD.size)
    header = _header(raw)
    return Head(f"SPZ {header.version}", header.count, y_up=True)


def read_spz(data: bytes, turn: bool = True) -> SplatFile:
    """The Gaussians of an SPZ, with Z up, or without `turn` as they are. SplatFileError without the file's name."""
    header, sections, extensions = _version_4(data) if data.startswith(NGSP) else _gzipped(data)
    splat = _gaussians(header, sections)
    axes = _axes(extensions)
    return transformed(splat, TURN.T @ axes) if turn else splat


def _header(raw: bytes) -> _Header:
    if len(raw) < _HEAD.size:
        raise SplatFileError("is truncated: its header has no end")
    magic, version, count, degree, bits, flags, _ = _HEAD.unpack_from(raw)
    if magic != MAGIC:
        raise SplatFileError("is packed by gzip, and what is in it is no SPZ")
    if not 1 <= version <= 4:
        raise SplatFileError(f"is SPZ of version {version}; this reader knows 1 to 4")
    if degree > 4:
        raise SplatFileError(f"has spherical harmonics of degree {degree}; SPZ holds 0 to 4")
    if count == 0:
        raise SplatFileError("has 0 Gaussians; expected at least one")
    if bits > 24:
        raise SplatFileError(f"has positions with {bits} bits after the point; they have 24 in all")
    return _Header(version, count, degree, bits, flags)


def _unpacked(unpack: Any, data: bytes, most: int) -> bytes:
    try:
        return bytes(unpack.decompress(data, most))
    except zlib.error as error:
        raise SplatFileError(f"is damaged: {error}") from None


def _gzipped(data: bytes) -> tuple[_Header, list[np.ndarray], bytes]:
    unpack = zlib.decompressobj(31)  # gzip
    header = _header(_unpacked(unpack, data, _HEAD.size))
    if header.version == 4:
        raise SplatFileError("is SPZ of version 4 packed by gzip; that version is packed by zstd")
    need = sum(header.sizes)
    if need > DEFLATE * len(data):
        raise SplatFileError(f"is truncated: {len(data)} bytes cannot hold {header.count} Gaussians")
    more = _MOST_EXTENSIONS if header.flags & _EXTENSIONS else 1
    content = _unpacked(unpack, unpack.unconsumed_tail, need + more)
    if len(content) < need or not unpack.eof:
        problem = "is truncated" if len(content) <= need else "is too long"
        raise SplatFileError(f"{problem}: expected {need} bytes for {header.count} Gaussians")
    if len(content) > need and not header.flags & _EXTENSIONS:
        raise SplatFileError(f"is too long: expected {need} bytes for {header.count} Gaussians")
    ends = np.cumsum([0, *header.sizes])
    sections = [np.frombuffer(content, np.uint8, e - s, s) for s, e in itertools.pairwise(ends)]
    return header, sections, content[need:]


def _version_4(data: bytes) -> tuple[_Header, list[np.ndarray], bytes]:
    header = _header(data)
    if header.version != 4 or len(data) < _HEAD_4.size:
        raise SplatFileError(f"is SPZ of version {header.version} without gzip, or truncated")
    *_, streams, table = _HEAD_4.unpack_from(data)
    sizes = [size for size in header.sizes if size]
    start = table + 16 * streams
    if streams != len(sizes) or table < _HEAD_4.size or start > len(data):
        raise SplatFileError(f"has {streams} streams at byte {table} of {len(data)}; expected {len(sizes)}")
    entries = np.frombuffer(data, "<u8", 2 * streams, table).reshape(-1, 2).tolist()
    if start + sum(packed for packed, _ in entries) != len(data) or [size for _, size in entries] != sizes:
        raise SplatFileError(f"is truncated, or not the {header.count} Gaussians that it says")
    unzstd, sections = _unzstd(), []
    for packed, size in entries:
        if size > _ZSTD * (packed + 1):
            raise SplatFileError(f"is truncated: {packed} bytes cannot hold {header.count} Gaussians")
        content = unzstd(data[start : start + packed], size)
        if len(content) != size:
            raise SplatFileError(f"is damaged: a stream has {len(content)} bytes, expected {size}")
        sections.append(np.frombuffer(content, np.uint8))
        start += packed
    empty = [np.empty(0, np.uint8)] * (len(header.sizes) - len(sections))
    return header, [*sections, *empty], data[_HEAD_4.size : table] if header.flags & _EXTENSIONS else b""


def _unzstd() -> Callable[[bytes, int], bytes]:
    """(packed, size) → bytes. Raises SplatFileError where no module unpacks zstd."""
    try:
        import zstandard
    except ImportError:
        raise SplatFileError(
            "is SPZ 4, packed by zstd, for which the Python module zstandard is needed: pip install zstandard, or save "
            "it as SPZ 3 or PLY"
        ) from None

    def unpack(packed: bytes, size: int) -> bytes:
        try:
            if zstandard.frame_content_size(packed) not in (size, -1):
                return b""
            return bytes(zstandard.ZstdDecompressor().decompress(packed, max_output_size=size))
        except zstandard.ZstdError as error:
            raise SplatFileError(f"is damaged: {' '.join(str(error).split())}") from None

    return unpack


def _axes(extensions: bytes) -> np.ndarray:
    """[3, 3]: from the file's axes to those of SPZ, by the extension that names them."""
    at = 0
    while at + 8 <= len(extensions):
        kind, size = struct.unpack_from("<II", extensions, at)
        at += 8
        if kind == _AXES and size == 4 and at + 4 <= len(extensions):
            number = struct.unpack_from("<I", extensions, at)[0]
            if number > len(_SYSTEMS):
                raise SplatFileError(f"names axes number {number}; SPZ knows {len(_SYSTEMS)}")
            if number:
                return np.array([_TOWARDS[letter] for letter in _SYSTEMS[number - 1]], np.float64).T
        at += size
    return np.eye(3)


def _gaussians(header: _Header, sections: list[np.ndarray]) -> SplatFile:
    n, k = header.count, (header.degree + 1) ** 2
    places, opacities, colours, scales, turns, rest = sections
    sh = np.empty((n, k, 3), np.float32)
    sh[:, 0] = (colours.reshape(n, 3) / np.float32(255) - np.float32(0.5)) / np.float32(COLOUR)
    sh[:, 1:] = (rest.reshape(n, k - 1, 3) - np.float32(128)) / np.float32(128)
    fields = {
        "means": _places(places, header),
        "quats": _turns(turns, header),
        "scales": np.exp(scales.reshape(n, 3) / np.float32(16) - np.float32(10)),
        "opacities": opacities / np.float32(255),
        "sh": sh,
    }
    return drawable(fields, [ANTIALIASED] if header.flags & _ANTIALIASED else [])


def _places(raw: np.ndarray, header: _Header) -> np.ndarray:
    """[N, 3] float32: half floats in version 1, else 24 bits."""
    if header.version == 1:
        return raw.view("<f2").reshape(-1, 3).astype(np.float32)
    wide = np.zeros((3 * header.count, 4), np.uint8)
    wide[:, 1:] = raw.reshape(-1, 3)
    fixed = wide.view("<i4")[:, 0] >> 8  # the sign comes along
    return np.ldexp(fixed.astype(np.float32), -header.bits).reshape(-1, 3)


def _turns(raw: np.ndarray, header: _Header) -> np.ndarray:
    """[N, 4] wxyz."""
    if header.version > 2:
        xyzw = _smallest_three(raw.view("<u4"))
    else:
        xyz = raw.reshape(-1, 3) / np.float32(127.5) - 1
        w = np.sqrt(np.maximum(1 - (xyz**2).sum(axis=1, keepdims=True), 0))
        xyzw = np.concatenate([xyz, w], axis=1)
    return xyzw[:, [3, 0, 1, 2]]


def _smallest_three(packed: np.ndarray) -> np.ndarray:
    """[N, 4] xyzw of [N] uint32, the inverse of `smallest_three`."""
    parts = np.stack([packed >> np.uint32(s) & np.uint32(1023) for s in (20, 10, 0)], axis=1)
    others = np.sqrt(0.5) / 511 * (parts & np.uint32(511)) * np.where(parts >> np.uint32(9), -1, 1)
    return largest_put_in(others, (packed >> np.uint32(30)).astype(np.intp))


def write_spz(path: str | Path, splat: SplatFile) -> None:
    """Write the scene at rest; its motion is left out. Replaces `path` in one step.

    Positions are kept to 2⁻²⁴ of the scene's size: the grid is as fine as 24 bits allow, not the 1/4096 that is
    usual, which would be as coarse as a subtle motion. Scales are kept to 3 % (e⁻¹⁰ to e⁶), turns to 0.1°,
    opacities to 1/510, colours to 0.013 in f_dc (±3.3) and 0.004 in further coefficients (±1).
    Raises SplatFileError if the file cannot be written, or for positions beyond ±8.4 million.
    """
    with replacing(Path(path)) as temporary:
        temporary.write_bytes(gzip.compress(_content(y_up(splat)), _LEVEL, mtime=0))


def _content(splat: SplatFile) -> bytes:
    reach = float(np.abs(splat.means).max())
    if reach > _LARGEST:
        raise SplatFileError(
            f"a position is {reach:g} scene units off the origin; spz holds up to {_LARGEST}"
        )
    bits = _MOST_BITS if reach == 0 else min(_MOST_BITS, math.floor(math.log2(_LARGEST / reach)))
    head = struct.pack("<IIIBBBB", MAGIC, _VERSION, len(splat), splat.sh_degree, bits, 0, 0)
    fixed = np.round(splat.means.astype(np.float64) * 2.0**bits).astype("<i4")
    sections = (
        np.ascontiguousarray(fixed).view(np.uint8).reshape(-1, 3, 4)[:, :, :3],
        _bytes(255.0 * splat.opacities),
        _bytes(255.0 * (COLOUR * splat.sh[:, 0] + 0.5)),
        _bytes(16.0 * (log_scale(splat.scales) + 10.0)),
        smallest_three(splat.quats),
        _bytes(128.0 * (splat.sh[:, 1:] + 1.0)),
    )
    return head + b"".join(section.tobytes() for section in sections)


def _bytes(values: np.ndarray) -> np.ndarray:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


def smallest_three(quats: np.ndarray) -> np.ndarray:
    """[N] uint32: which of x, y, z, w is largest in the 2 highest bits, then sign and 9 bits of each other one.

    quats [N, 4] wxyz of any length but 0.
    """
    xyzw = quats.astype(np.float64)[:, [1, 2, 3, 0]]
    xyzw /= np.linalg.norm(xyzw, axis=1, keepdims=True)
    rows, largest = np.arange(len(xyzw)), np.abs(xyzw).argmax(axis=1)
    xyzw *= np.where(xyzw[rows, largest] < 0, -1.0, 1.0)[:, None]
    packed = largest.astype(np.uint32)
    for i in range(4):
        size = np.minimum(np.round(511.0 * math.sqrt(2.0) * np.abs(xyzw[:, i])), 511).astype(np.uint32)
        one = (xyzw[:, i] < 0).astype(np.uint32) << np.uint32(9) | size
        packed = np.where(largest == i, packed, packed << np.uint32(10) | one)
    return packed.astype("<u4")
