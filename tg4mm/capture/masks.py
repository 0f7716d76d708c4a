"""Masks: which pixels of a picture count (white), and where a person says that motion may be.

A picture's own mask is a frame's `mask_path` (nerfstudio) or masks/<name>.png (COLMAP), black where it is ignored. One
for the one fixed camera is a PNG or a polygon that a person gives.
"""

from functools import lru_cache
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from tg4mm.capture.model import Capture
from tg4mm.core.errors import CaptureError
from tg4mm.core.pictures.decode import decode


def mask_of(capture: Capture, i: int) -> np.ndarray | None:
    """[H, W] bool of picture i, true where it counts; None where it has no mask.

    Raises CaptureError for a mask of another size than its picture, and for one that leaves nothing.
    """
    path = capture.masks[i] if capture.masks else None
    if path is None:
        return None
    lens = capture.lenses[i] if capture.lenses else None
    size = (capture.width, capture.height)
    own = (lens.taken_of or size) if lens is not None else size
    white = _read(path, own)
    if lens is not None:
        shown = np.repeat(np.where(white, 255, 0).astype(np.uint8)[..., None], 3, axis=2)
        white = lens.apply(shown)[..., 0] > 254  # what is ignored in part is ignored
    return white


def _read(path: Path, size: tuple[int, int]) -> np.ndarray:
    """[H, W] bool of a mask for a picture of (width, height)."""
    state = path.stat()
    return _read_once(path, size, state.st_size, state.st_mtime_ns)


@lru_cache(64)
def _read_once(path: Path, size: tuple[int, int], length: int, changed_ns: int) -> np.ndarray:
    image = decode(path)
    if image.shape[1::-1] != size:
        raise CaptureError(
            f"{path}: the mask is {image.shape[1]}×{image.shape[0]} pixels, its picture {size[0]}×{size[1]}"
        )
    white = (image[..., :3].max(2) > 0) & (image[..., 3] > 0)
    return _not_empty(white, str(path))


def _not_empty(white: np.ndarray, name: str) -> np.ndarray:
    if not white.any():
        raise CaptureError(f"{name}: the mask is empty: no pixel of the picture is left")
    return white


def region_mask(text: str, size: tuple[int, int]) -> np.ndarray:
    """[H, W] bool of "X,Y X,Y X,Y …", a polygon in pixels, or of a PNG's path, for pictures of (width, height).

    Raises CaptureError for a polygon of fewer than three corners, one with no pixel in it, a mask of another size, and
    for a file that is not there.
    """
    corners = _corners(text)
    if corners is None:
        path = Path(text)
        if not path.is_file():
            raise CaptureError(f"{text!r} is neither a mask's file nor a polygon, X,Y X,Y X,Y in pixels")
        return _read(path, size)
    if len(corners) < 3:
        raise CaptureError(f"{text!r} has {len(corners)} corners, a polygon has three or more")
    image = Image.new("1", size)
    ImageDraw.Draw(image).polygon([(x - 0.5, y - 0.5) for x, y in corners], fill=1)
    return _not_empty(np.array(image, bool), repr(text))


def _corners(text: str) -> list[tuple[float, float]] | None:
    """None for what is no list of pairs of numbers."""
    try:
        pairs = [tuple(float(n) for n in part.split(",")) for part in text.split()]
    except ValueError:
        return None
    if not pairs or any(len(p) != 2 or not np.isfinite(p).all() for p in pairs):
        return None
    return [(p[0], p[1]) for p in pairs]
