"""TIFF of 8 or 16 bits, page by page: by Pillow, but 16-bit colour, of which it keeps the high byte, by tifffile."""

import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import TiffImageFile

MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA")  # Pillow's names; CMYK and others are refused
GREY_16 = ("I;16", "I;16B")
STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_BITS, _PHOTOMETRIC, _TURNED, _EXTRA, _SAMPLES = 258, 262, 274, 338, 339  # tags
_INTEGERS, _STRAIGHT = 1, 2

warnings.filterwarnings("ignore", module=r"PIL\.TiffImagePlugin")  # a word for each tag that it skips


def opened(path: Path) -> TiffImageFile:
    """The file at its first page, to be used by `with`."""
    image = Image.open(path, formats=["TIFF"])
    assert isinstance(image, TiffImageFile)
    return image


def bits_of(image: TiffImageFile) -> int:
    """Per channel once decoded: 8, or 16 of what holds more."""
    return 16 if max(image.tag_v2.get(_BITS, (1,))) > 8 else 8


def page_count(path: Path) -> int:
    """Pictures of the first one's size: 1 for a photograph, though a thumbnail may follow it."""
    with opened(path) as image:
        size, count = image.size, image.n_frames
        if count > 1:
            image.seek(1)
        return count if image.size == size else 1


def decode(path: Path) -> np.ndarray:
    """[H, W, 4] uint8 or uint16, straight alpha, of the first page. ValueError for what is not read."""
    return next(decode_pages(path))


def decode_pages(path: Path) -> Iterator[np.ndarray]:
    """All pages, as `decode`."""
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
        raise ValueError("is neither grey nor RGB of 8 or 16 bits with straight alpha")
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
