"""One PNG, JPEG, WebP, TIFF or EXR → RGBA, straight alpha, 8 or 16 bits; grey, palette or RGB."""

import os
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import TiffImageFile

from tg4mm.core.errors import CaptureError
from tg4mm.core.pictures import exr, png, tiff
from tg4mm.core.untrusted import DEFLATE

THREADS = min(8, os.cpu_count() or 1)
FORMATS = ("PNG", "JPEG", "WEBP", "TIFF")
# What Pillow raises on a damaged file, depending on where the damage is.
DAMAGE: tuple[type[BaseException], ...] = (
    *(OSError, SyntaxError, ValueError, EOFError, struct.error, zlib.error, MemoryError, ArithmeticError),
    *(RuntimeError, IndexError, KeyError, TypeError, AttributeError, Image.DecompressionBombError),
)
# Pixels, at most, that one byte of a file stands for. Of a PNG: of one bit each, packed by zlib. A JPEG has a bit or
# more for every 64 pixels, an EXR two bytes a pixel, packed by zlib. Of a WebP, whose size is held to 16383 a side, a
# byte may stand for any number.
_PIXELS_PER_BYTE = 8 * DEFLATE
_LARGEST_WEBP = 178_956_970  # pixels, Pillow's own limit


@dataclass(frozen=True)
class ImageHeader:
    """The header of an image file."""

    width: int  # pixels
    height: int  # pixels
    bits: int  # per channel once decoded, 8 or 16


def image_header(path: Path) -> ImageHeader:
    """Size and depth without decoding.

    Raises CaptureError if it is no PNG, JPEG, WebP, TIFF or EXR, holds several pictures, is CMYK and the like, or
    promises more pixels than a file of its length can hold.
    """
    header = _header(path)
    length = path.stat().st_size
    pixels = header.width * header.height
    if not 0 < pixels <= length * _PIXELS_PER_BYTE and not (0 < pixels <= _LARGEST_WEBP and _is_webp(path)):
        promised = f"{header.width}×{header.height} pixels"
        raise CaptureError(f"{path}: cannot be decoded: {promised} do not fit in its {length} bytes")
    return header


def _header(path: Path) -> ImageHeader:
    try:
        start = _start(path)
        if start.startswith(exr.SIGNATURE):
            return ImageHeader(*exr.size(path), 16)
        header = png.read_header(start)
        if header is not None and header.bits == 16:
            return ImageHeader(header.width, header.height, 16)
        with Image.open(path, formats=FORMATS) as image:
            deep = isinstance(image, TiffImageFile) and tiff.bits_of(image) == 16
            if image.mode not in tiff.MODES and not (deep and image.mode in tiff.GREY_16):
                raise CaptureError(f"{path}: has colour mode {image.mode}; expected grey, RGB or RGBA")
            size, pages = image.size, getattr(image, "n_frames", 1)
        if start.startswith(tiff.STARTS):
            pages = tiff.page_count(path)
        if pages > 1:
            raise CaptureError(
                f"{path}: holds {pages} pictures; expected one (a TIFF of several is a recording: give it alone)"
            )
        return ImageHeader(*size, 16 if deep else 8)
    except CaptureError:
        raise
    except DAMAGE as error:
        raise _unreadable(path, error) from error


def decode(path: Path) -> np.ndarray:
    """[H, W, 4] uint8 (uint16 for a 16-bit PNG or TIFF or an EXR); files without alpha get the largest value there.

    Raises CaptureError if the file is truncated or damaged.
    """
    try:
        if _start(path).startswith(exr.SIGNATURE):
            image_header(path)
            return exr.decode(path)
        bits = image_header(path).bits
        if _start(path).startswith(tiff.STARTS):
            return tiff.decode(path)
        if bits == 16:  # Pillow would keep the high byte only
            return png.decode(path.read_bytes())
        with Image.open(path, formats=FORMATS) as image:
            return np.asarray(image.convert("RGBA"))
    except CaptureError:
        raise
    except DAMAGE as error:
        raise _unreadable(path, error) from error


def _start(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(png.HEADER_BYTES)


def _is_webp(path: Path) -> bool:
    start = _start(path)
    return start.startswith(b"RIFF") and start[8:12] == b"WEBP"


def _unreadable(path: Path, error: BaseException) -> CaptureError:
    if isinstance(error, Image.UnidentifiedImageError):
        return CaptureError(f"{path}: is neither a PNG, a JPEG, a WebP, a TIFF nor an EXR")
    return CaptureError(f"{path}: cannot be decoded: {' '.join(str(error).split())}")
