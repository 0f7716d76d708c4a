"""One PNG, JPEG or EXR → RGBA, straight alpha, 8 or 16 bits; grey, palette or RGB, with or without alpha."""

import os
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from tg4mm.core.errors import CaptureError
from tg4mm.core.pictures import exr, png16
from tg4mm.core.untrusted import DEFLATE

THREADS = min(8, os.cpu_count() or 1)
FORMATS = ("PNG", "JPEG")
MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA")  # Pillow's names; CMYK and others are refused
# What Pillow raises on a damaged file, depending on where the damage is.
DAMAGE: tuple[type[BaseException], ...] = (
    *(OSError, SyntaxError, ValueError, EOFError, struct.error, zlib.error, MemoryError, OverflowError),
    *(RuntimeError, IndexError, KeyError, TypeError, AttributeError, Image.DecompressionBombError),
)
# Pixels, at most, that one byte of a file stands for. Of a PNG: of one bit each, packed by zlib. A JPEG has a bit or
# more for every 64 pixels, an EXR two bytes a pixel, packed by zlib.
_PIXELS_PER_BYTE = 8 * DEFLATE


@dataclass(frozen=True)
class ImageHeader:
    """What the first bytes of an image file say."""

    width: int  # pixels
    height: int  # pixels
    bits: int  # per channel once decoded, 8 or 16


def image_header(path: Path) -> ImageHeader:
    """Size and depth without decoding.

    Raises CaptureError if it is no PNG, JPEG or EXR, or CMYK and the like, or promises more pixels than a file of its
    length can hold.
    """
    header = _header(path)
    length = path.stat().st_size
    if not 0 < header.width * header.height <= length * _PIXELS_PER_BYTE:
        promised = f"{header.width}×{header.height} pixels"
        raise CaptureError(f"{path}: cannot be decoded: {promised} do not fit in its {length} bytes")
    return header


def _header(path: Path) -> ImageHeader:
    try:
        start = _start(path)
        if start.startswith(exr.SIGNATURE):
            return ImageHeader(*exr.size(path), 16)
        header = png16.read_header(start)
        if header is not None and header.bits == 16:
            return ImageHeader(header.width, header.height, 16)
        with Image.open(path, formats=FORMATS) as image:
            if image.mode not in MODES:
                raise CaptureError(f"{path}: has colour mode {image.mode}; expected grey, RGB or RGBA")
            return ImageHeader(*image.size, 8)
    except CaptureError:
        raise
    except DAMAGE as error:
        raise _unreadable(path, error) from error


def decode(path: Path) -> np.ndarray:
    """[H, W, 4] uint8 (uint16 for a 16-bit PNG or an EXR); files without alpha get the largest value there.

    Raises CaptureError if the file is truncated or damaged.
    """
    try:
        if _start(path).startswith(exr.SIGNATURE):
            image_header(path)
            return exr.decode(path)
        if image_header(path).bits == 16:  # Pillow would keep the high byte only
            return png16.decode(path.read_bytes())
        with Image.open(path, formats=FORMATS) as image:
            return np.asarray(image.convert("RGBA"))
    except CaptureError:
        raise
    except DAMAGE as error:
        raise _unreadable(path, error) from error


def _start(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(png16.HEADER_BYTES)


def _unreadable(path: Path, error: BaseException) -> CaptureError:
    if isinstance(error, Image.UnidentifiedImageError):
        return CaptureError(f"{path}: is neither a PNG, a JPEG nor an EXR")
    return CaptureError(f"{path}: cannot be decoded: {' '.join(str(error).split())}")
