"""The splat file: one 3DGS PLY with motion riding along (docs/conventions.md). Needs numpy alone."""

from .formula import positions_at, rotations_at
from .model import SplatFile
from .read import read_splat
from .write import write_splat

__all__ = ["SplatFile", "positions_at", "read_splat", "rotations_at", "write_splat"]
