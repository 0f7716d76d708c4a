"""Reading SPZ, version 1 to 3 (gzip) and 4 (zstd, where a module for it is there).

The layout is that of the reference library (github.com/nianticlabs/spz): x right, Y up, z backwards, unless an
extension names other axes. What is read is turned to Z up.
"""

from __future__ import annotations

import itertools
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np

from ..errors import SplatFileError
from ..untrusted import DEFLATE
from . import spz
from .axes import TURN, transformed
from .drawable import drawable
from .model import SplatFile
from .source import Head
from .supersplat import largest_put_in

GZIP, NGSP = b"\x1f\x8b", b"NGSP"
_HEAD, _HEAD_4 = struct.Struct("<IIIBBBB"), struct.Struct("<IIIBBBBI12x")
_EXTENSIONS, _MOST_EXTENSIONS = 2, 1 << 20  # a flag; bytes after the Gaussians that are looked at
_ZSTD = 1 << 17  # bytes, at most, that one byte packed by zstd stands for: a block of one value
_AXES = 0xADBE0003  # the extension that names the axes, one of these, right left up down back front
_SYSTEMS = tuple(x + rest for rest in ("DB", "UB", "DF", "UF", "FD", "FU", "BD", "BU") for x in "LR")
_TOWARDS = {"R": (1, 0, 0), "L": (-1, 0, 0), "U": (0, 1, 0), "D": (0, -1, 0), "B": (0, 0, 1), "F": (0, 0, -1)}


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
    """What the header says."""
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
    if magic != spz.MAGIC:
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
    sh[:, 0] = (colours.reshape(n, 3) / np.float32(255) - np.float32(0.5)) / np.float32(spz.COLOUR)
    sh[:, 1:] = (rest.reshape(n, k - 1, 3) - np.float32(128)) / np.float32(128)
    fields = {
        "means": _places(places, header),
        "quats": _turns(turns, header),
        "scales": np.exp(scales.reshape(n, 3) / np.float32(16) - np.float32(10)),
        "opacities": opacities / np.float32(255),
        "sh": sh,
    }
    return drawable(fields)


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
    """[N, 4] xyzw of [N] uint32, the inverse of `spz.smallest_three`."""
    parts = np.stack([packed >> np.uint32(s) & np.uint32(1023) for s in (20, 10, 0)], axis=1)
    others = np.sqrt(0.5) / 511 * (parts & np.uint32(511)) * np.where(parts >> np.uint32(9), -1, 1)
    return largest_put_in(others, (packed >> np.uint32(30)).astype(np.intp))
