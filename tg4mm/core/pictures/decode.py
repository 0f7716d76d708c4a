"""One PNG, JPEG, WebP, TIFF or EXR → RGBA, straight alpha, 8 or 16 bits; grey, palette or RGB. PNG written atomically.

TIFF goes by Pillow page by page, but 16-bit colour, of which that keeps the high byte, by tifffile.
"""

import io
import os
import struct
import warnings
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import TiffImageFile

from tg4mm.core.errors import CaptureError, RunError
from tg4mm.core.files import write_atomic
from tg4mm.core.pictures import exr, png
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

MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA")  # Pillow's names; CMYK and others are refused
GREY_16 = ("I;16", "I;16B")
STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_BITS, _PHOTOMETRIC, _TURNED, _EXTRA, _SAMPLES = 258, 262, 274, 338, 339  # tags
_INTEGERS, _STRAIGHT = 1, 2

warnings.filterwarnings("ignore", module=r"PIL\.TiffImagePlugin")  # a word for each tag that it skips


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
            deep = isinstance(image, TiffImageFile) and bits_of(image) == 16
            if image.mode not in MODES and not (deep and image.mode in GREY_16):
                raise CaptureError(f"{path}: has colour mode {image.mode}; expected grey, RGB or RGBA")
            size, pages = image.size, getattr(image, "n_frames", 1)
        if start.startswith(STARTS):
            pages = page_count(path)
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
    """Decode [H, W, 4] uint8 (uint16 for a 16-bit PNG or TIFF or an EXR); files without alpha become opaque.

    Raises CaptureError if the file is truncated or damaged.
    """
    try:
        if _start(path).startswith(exr.SIGNATURE):
            image_header(path)
            return exr.decode(path)
        bits = image_header(path).bits
        if _start(path).startswith(STARTS):
            return next(decode_pages(path))
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


def opened(path: Path) -> TiffImageFile:
    """The file at its first page, to be used by `with`."""
    image = Image.open(path, formats=["TIFF"])
    assert isinstance(image, TiffImageFile)
    return image


def bits_of(image: TiffImageFile) -> int:
    """Return the bits per channel after decoding: 8, or 16 for deeper files."""
    return 16 if max(image.tag_v2.get(_BITS, (1,))) > 8 else 8


def page_count(path: Path) -> int:
    """Pictures of the first one's size: 1 for a photograph, though a thumbnail may follow it."""
    with opened(path) as image:
        size, count = image.size, image.n_frames
        if count > 1:
            image.seek(1)
        return count if image.size == size else 1


def decode_pages(path: Path) -> Iterator[np.ndarray]:
    """Yield pages [H, W, 4] of a TIFF, uint8 or uint16, straight alpha. Raises ValueError for unread kinds."""
    with opened(path) as image:
        for page in range(image.n_frames):
            image.seek(page)
            yield _rgba(path, page, image)


def _rgba(path: Path, page: int, image: TiffImageFile) -> np.ndarray:
    tags = dict(image.tag_v2)
    if bits_of(image) == 8:
        if image.mode not in MODES:
            raise ValueError(f"page {page} has colour mode {image.mode}; expected grey, RGB or RGBA")
        return np.asarray(image.convert("RGBA"))
    pixels = _grey(image, tags) if image.mode in GREY_16 else _colour(path, page, tags)
    rgba = np.full((*pixels.shape[:2], 4), 65535, np.uint16)
    rgba[..., : pixels.shape[2]] = pixels
    return rgba


def _grey(image: TiffImageFile, tags: dict) -> np.ndarray:
    grey = np.asarray(image).astype(np.uint16)
    if tags[_BITS][0] == 12:
        grey = (grey << 4 | grey >> 8).astype(np.uint16)
    if tags.get(_PHOTOMETRIC) == 0:
        grey = ~grey
    return np.repeat(grey[..., None], 3, axis=-1)


def _colour(path: Path, page: int, tags: dict) -> np.ndarray:
    extra = tuple(tags.get(_EXTRA, ()))
    kinds = set(tags.get(_SAMPLES, (_INTEGERS,)))
    if (
        tags.get(_PHOTOMETRIC) != 2
        or set(tags[_BITS]) != {16}
        or kinds != {_INTEGERS}
        or extra not in ((), (0,), (2,))
    ):
        raise ValueError(
            "is neither grey nor RGB with 8 or 16 bits per channel; an alpha channel, if there is one, must be "
            "straight (not premultiplied)"
        )
    if tags.get(_TURNED, 1) != 1:
        raise ValueError("is 16-bit colour that is to be turned")
    try:
        import tifffile
    except ImportError:
        raise ValueError("16-bit colour needs tifffile: pip install tifffile") from None
    with tifffile.TiffFile(path) as file:
        pixels = np.asarray(file.pages[page].asarray())
    if tags.get(284, 1) == 2:  # a plane for each channel
        pixels = np.moveaxis(pixels, 0, -1)
    return pixels if extra == (_STRAIGHT,) else pixels[..., :3]


def to_bytes(image: np.ndarray) -> np.ndarray:
    """Float picture in 0..1, any shape, as uint8, rounded to nearest."""
    return (np.clip(image, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)


def png_bytes(image: np.ndarray) -> bytes:
    """A PNG of a picture [H, W, 3 | 4] or [H, W]; float 0..1 or uint8."""
    pixels = image if image.dtype == np.uint8 else to_bytes(image)
    buffer = io.BytesIO()
    # of level 6 twice the time, for 6 % of the bytes
    Image.fromarray(pixels).save(buffer, "PNG", optimize=False, compress_level=4)
    return buffer.getvalue()


def write_png(path: Path, image: np.ndarray) -> None:
    """Write a picture as `png_bytes` makes it, whole or not at all; makes the folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    data = png_bytes(image)
    write_atomic(path, lambda temporary: temporary.write_bytes(data))


def read_png(path: Path) -> np.ndarray:
    """A picture file as uint8 [H, W, 3]; transparent ones are composited over white. Raises RunError."""
    try:
        raw = decode(path)
    except CaptureError as error:
        raise RunError(str(error)) from None
    return bytes_over_white(raw)


def bytes_over_white(raw: np.ndarray) -> np.ndarray:
    """Return [H, W, 3] uint8 of a picture [H, W, 4] as stored."""
    if raw.dtype == np.uint8 and (raw[..., 3] == 255).all():
        return np.ascontiguousarray(raw[..., :3])
    rgba = raw / np.float32(np.iinfo(raw.dtype).max)
    return to_bytes(rgba[..., :3] * rgba[..., 3:] + 1.0 - rgba[..., 3:])
