"""Captures: the images of a scene with cameras and times, read from a folder. Needs no torch, no bpy.

The names are imported when they are first asked for, so that the options of the command line need no numpy.
"""

from typing import TYPE_CHECKING

from tg4mm.core.extras import lazily

if TYPE_CHECKING:
    from tg4mm.capture.model import Capture, SurfacePoints
    from tg4mm.capture.pictures import ImageStack, load_images
    from tg4mm.capture.readers import load_capture

__all__ = ["Capture", "ImageStack", "SurfacePoints", "load_capture", "load_images"]

__getattr__ = lazily(
    __name__,
    {
        "Capture": "model",
        "ImageStack": "pictures",
        "SurfacePoints": "model",
        "load_capture": "readers",
        "load_images": "pictures",
    },
)
