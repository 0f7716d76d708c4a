"""The splat file: one 3DGS PLY with motion riding along, and what others write. Needs numpy alone."""

from tg4mm.core.splatfile.ply import write_splat

from .formula import positions_at, rotations_at
from .model import SplatFile
from .read import read_head, read_splat

__all__ = ["SplatFile", "positions_at", "read_head", "read_splat", "rotations_at", "write_splat"]
