"""Picture files, written atomically, and read as 8-bit colours."""

import io
from pathlib import Path

import numpy as np
from PIL import Image

from tg4mm.core.errors import CaptureError, RunError
from tg4mm.core.files import write_atomic
from tg4mm.core.pictures.decode import decode


def to_bytes(image: np.ndarray) -> np.ndarray:
    """Float picture in 0..1, any shape, as uint8, rounded to nearest."""
    return (np.clip(image, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)


def png_bytes(image: np.ndarray) -> bytes:
    """A PNG of a picture [H, W, 3 | 4] or [H, W]; float 0..1 or uint8."""
    pixels = image if image.dtype == np.uint8 else to_bytes(image)
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG", optimize=False, compress_level=6)
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
    if raw.dtype == np.uint8 and (raw[..., 3] == 255).all():
        return np.ascontiguousarray(raw[..., :3])
    rgba = raw / np.float32(np.iinfo(raw.dtype).max)
    return to_bytes(rgba[..., :3] * rgba[..., 3:] + 1.0 - rgba[..., 3:])
