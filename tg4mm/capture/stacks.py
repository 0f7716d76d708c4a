"""Recordings in files of plain pictures, as high-speed cameras write them: TIFF of several pages, Photron's MRAW.

Photron's header (.cih: `Key : value` a line; .cihx: XML) says size, depth, rate and number of the pictures in the .mraw
file beside it, which holds them one after another without anything between them.
"""

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from tg4mm.core.errors import CaptureError
from tg4mm.core.pictures import decode
from tg4mm.core.pictures.decode import DAMAGE

TIFF_SUFFIXES = (".tif", ".tiff")
PHOTRON_SUFFIXES = (".cih", ".cihx")
STACK_SUFFIXES = (*TIFF_SUFFIXES, *PHOTRON_SUFFIXES, ".mraw")
_LARGEST_HEADER = 1 << 20  # bytes
_MOST = 1 << 20  # pixels a side, frames
# Of .cih, and of .cihx below the element of that name.
_KEYS = {
    "rate": ("Record Rate(fps)", "recordInfo", "recordRate"),
    "frames": ("Total Frame", "frameInfo", "totalFrame"),
    "width": ("Image Width", "resolution", "width"),
    "height": ("Image Height", "resolution", "height"),
    "bits": ("Color Bit", "colorInfo", "bit"),
    "colour": ("Color Type", "colorInfo", "type"),
    "depth": ("EffectiveBit Depth", "effectiveBit", "depth"),
    "side": ("EffectiveBit Side", "effectiveBit", "side"),
    "format": ("File Format", "imageFileInfo", "fileFormat"),
}


@dataclass(frozen=True)
class Stack:
    """A stack file's description of its pictures."""

    count: int
    rate: Fraction | None  # pictures a second; None: it does not say


def is_stack(path: Path) -> bool:
    """Return whether the name is that of a stack file."""
    return path.suffix.lower() in STACK_SUFFIXES


def stack_info(path: Path) -> Stack:
    """Count pictures without decoding. Raises CaptureError for a truncated file, or one picture."""
    if path.suffix.lower() in TIFF_SUFFIXES:
        return Stack(_pages(path), None)
    photron = _photron(path)
    return Stack(photron.frames, photron.rate)


def stack_pictures(path: Path) -> Iterator[np.ndarray]:
    """Yield [H, W, 4] uint8 or uint16 each, over their full range. Raises CaptureError where one cannot be decoded."""
    if path.suffix.lower() not in TIFF_SUFFIXES:
        yield from _photron(path).pictures()
        return
    _pages(path)
    try:
        yield from decode.decode_pages(path)
    except DAMAGE as error:
        raise CaptureError(f"{path}: cannot be decoded: {' '.join(str(error).split())}") from error


def _pages(path: Path) -> int:
    try:
        count = decode.page_count(path)
    except DAMAGE as error:
        raise CaptureError(
            f"{path}: is no TIFF that can be decoded: {' '.join(str(error).split())}"
        ) from error
    if count < 2:
        raise CaptureError(
            f"{path}: holds one picture; a recording is a TIFF of several pictures, or a folder of pictures"
        )
    return count


@dataclass(frozen=True)
class _Photron:
    data: Path
    width: int
    height: int
    frames: int
    rate: Fraction
    bits: int  # that a pixel takes in the file: 8, 12 or 16
    shift: int  # by which a pixel of 16 bits is to be moved up to reach over the full range

    def pictures(self) -> Iterator[np.ndarray]:
        pixels = self.width * self.height
        with self.data.open("rb") as file:
            for _ in range(self.frames):
                raw = np.frombuffer(file.read(pixels * self.bits // 8), np.uint8)
                if len(raw) < pixels * self.bits // 8:
                    raise CaptureError(f"{self.data}: was cut off while it was read")
                grey = self._unpacked(raw).reshape(self.height, self.width)
                rgba = np.full((*grey.shape, 4), np.iinfo(grey.dtype).max, grey.dtype)
                rgba[..., :3] = grey[..., None]
                yield rgba

    def _unpacked(self, raw: np.ndarray) -> np.ndarray:
        if self.bits == 8:
            return raw
        if self.bits == 16:
            return raw.view("<u2").astype(np.uint16) << self.shift
        first, both, second = raw.reshape(-1, 3).astype(np.uint16).T
        return np.stack([first << 8 | (both >> 4) << 4, (both & 15) << 12 | second << 4], axis=1).ravel()


def _photron(path: Path) -> _Photron:
    header = path
    if path.suffix.lower() == ".mraw":
        header = _beside(path, PHOTRON_SUFFIXES, "its header .cih or .cihx")
    data = _beside(header, (".mraw",), "the pictures .mraw")
    found = _header(header)

    def whole(name: str) -> int:
        try:
            value = int(float(found[name]))
        except (ValueError, OverflowError):
            value = 0
        if not 0 < value <= _MOST:
            raise CaptureError(f"{header}: {_KEYS[name][0]} is {found[name][:40]!r}, expected 1 to {_MOST}")
        return value

    bits, depth, colour = whole("bits"), whole("depth"), found["colour"].lower()
    if (
        found["format"].lower() != "mraw"
        or bits not in (8, 12, 16)
        or not colour.startswith("mono")
        or depth > bits
    ):
        raise CaptureError(
            f"{header}: {found['format'][:40]}, {colour[:40]}, {depth} of {bits} bits: expected MRAW, Mono, "
            "of 8, 12 or 16 bits; save it as TIFF"
        )
    try:
        rate = Fraction(found["rate"]).limit_denominator(1001)
    except (ValueError, ZeroDivisionError):
        rate = Fraction(0)
    if not 0 < rate < 10**9:
        raise CaptureError(f"{header}: {_KEYS['rate'][0]} is {found['rate'][:40]!r}, expected more than 0")
    width, height, frames = whole("width"), whole("height"), whole("frames")
    if width * height * bits % 8:
        raise CaptureError(f"{header}: {width}×{height} pixels of {bits} bits do not fill whole bytes")
    size, wanted = os.path.getsize(data), frames * width * height * bits // 8
    if size < wanted:
        raise CaptureError(f"{data}: is cut off: {size} bytes, its header {header.name} promises {wanted}")
    lower = found["side"].lower() != "higher"
    return _Photron(data, width, height, frames, rate, bits, 16 - depth if bits == 16 and lower else 0)


def _beside(path: Path, suffixes: tuple[str, ...], what: str) -> Path:
    folder = path.parent
    names = {p.name.lower(): p for p in folder.iterdir()} if folder.is_dir() else {}
    for suffix in suffixes:
        if (found := names.get(path.stem.lower() + suffix)) is not None and found.is_file():
            return found
    raise CaptureError(f"{path}: {what} is not beside it")


def _header(path: Path) -> dict[str, str]:
    """The values of `_KEYS`, as written. Raises CaptureError where one is missing."""
    try:
        with path.open("rb") as file:
            text = file.read(_LARGEST_HEADER).decode("utf-8", "replace")
    except OSError as error:
        raise CaptureError(f"{path}: cannot be read: {error.strerror}") from error
    out = {}
    for name, (key, parent, child) in _KEYS.items():
        if path.suffix.lower() == ".cih":
            found = re.search(rf"^{re.escape(key)}\s*:\s*(.+?)\s*$", text, re.MULTILINE)
        else:
            inside = re.search(rf"<{parent}>(.*?)</{parent}>", text, re.DOTALL)
            found = inside and re.search(rf"<{child}>\s*([^<]*?)\s*</{child}>", inside[1])
        if found is None:
            raise CaptureError(
                f"{path}: has no {key if path.suffix.lower() == '.cih' else f'{parent}/{child}'}"
            )
        out[name] = found[1]
    return out
