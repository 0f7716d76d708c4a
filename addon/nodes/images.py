"""Pictures in files, decoded by Blender itself, number for number."""

from __future__ import annotations

import bpy
import numpy as np


def pixels(data: bytes) -> np.ndarray:
    """[H, W, channels] float32 in 0..1 of a picture file, as its numbers are, first row at the top."""
    image = bpy.data.images.new("tg4mm", 1, 1)
    try:
        image.colorspace_settings.name, image.alpha_mode = "Non-Color", "CHANNEL_PACKED"
        image.pack(data=data, data_len=len(data))
        image.source = "FILE"
        width, height = image.size
        found = np.empty((height, width, image.channels), np.float32)
        image.pixels.foreach_get(found.ravel())
    finally:
        bpy.data.images.remove(image)
    return found[::-1]


def decode(data: bytes) -> np.ndarray:
    """[H, W, 4] uint8: lossless WebP, as SOG has it. Raises ValueError for what Blender cannot read."""
    found = pixels(data)
    if not found.any():  # what 4.5 gives for a picture that it fails to read
        raise ValueError("Blender cannot read it as a picture")
    return np.rint(found * 255).astype(np.uint8)
