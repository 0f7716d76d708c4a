"""Captures: the images of a scene with cameras and times, read from a folder. Needs no torch, no bpy."""

from tg4mm.capture.model import Capture, SurfacePoints
from tg4mm.capture.pictures import ImageStack, load_images
from tg4mm.capture.readers import load_capture
from tg4mm.core.magnification import check_band

__all__ = ["Capture", "ImageStack", "SurfacePoints", "check_band", "load_capture", "load_images"]
