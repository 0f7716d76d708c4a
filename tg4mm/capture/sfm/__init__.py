"""Structure from motion with pycolmap: points for known cameras, and cameras for photographs. Needs no torch."""

from tg4mm.capture.sfm.engine import available
from tg4mm.capture.sfm.triangulate import SfmPoints, TriangulationConfig, triangulate_views

__all__ = ["SfmPoints", "TriangulationConfig", "available", "triangulate_views"]
