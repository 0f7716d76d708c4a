"""Picture files: written atomically, and checked for truncation without decoding."""

import io
import os
import struct
from pathlib import Path

import numpy as np
from PIL import Image

from tg4mm.core.errors import CaptureError, RunError
from tg4mm.core.files import write_atomic
from tg4mm.core.pictures.decode import decode

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_END = b"\x00\x00\x00\x00IEND\xaeB`\x82"


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


def is_complete_png(path: Path, width: int, height: int) -> bool:
    """Return whether `path` is a PNG of that size with an intact end (a killed copy lacks it)."""
    try:
        with path.open("rb") as file:
            head = file.read(24)
            file.seek(0, os.SEEK_END)
            if file.tell() < 24 + len(_END):
                return False
            file.seek(-len(_END), os.SEEK_END)
            tail = file.read()
    except OSError:
        return False
    return head[:8] == _SIGNATURE and struct.unpack(">II", head[16:24]) == (width, height) and tail == _END


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
