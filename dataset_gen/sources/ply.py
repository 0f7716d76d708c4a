"""Looks for vertices of a PLY file that are not finite: Blender's importer silently moves them to the origin."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..errors import GenerateError

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_HEADER = re.compile(rb"ply\r?\n.*?end_header\r?\n", re.S)
_LONGEST = 1 << 16  # bytes of a header
_NO_NUMBER = re.compile(rb"(?<![\w.])[+-]?(?:nan|inf)", re.I)


def count_not_finite(path: Path) -> int:
    """How many vertices have a coordinate that is not finite; 0 where the layout is not one this can read.

    An ASCII file counts by lines, of whatever element. Raises GenerateError for a file shorter than its header says.
    """
    with path.open("rb") as file:
        head = _HEADER.match(file.read(_LONGEST))
        if head is None:
            return 0
        lines = head[0].decode("latin-1").split("\n")
        kind = next(
            (line.removeprefix("format ").partition(" ")[0] for line in lines if line[:7] == "format "), ""
        )
        file.seek(head.end())
        if kind == "ascii":
            return sum(1 for line in file if _NO_NUMBER.search(line))
        layout = _vertices(lines, "<" if kind == "binary_little_endian" else ">")
        if layout is None:
            return 0
        dtype, count = layout
        if count * dtype.itemsize > path.stat().st_size - head.end():
            raise GenerateError(f"{path}: is truncated: its header promises {count} vertices")
        vertices = np.fromfile(file, dtype, count)
    places = np.stack([vertices[axis].astype(np.float64) for axis in "xyz"], -1)
    return int((~np.isfinite(places).all(1)).sum())


def _vertices(lines: list[str], order: str) -> tuple[np.dtype, int] | None:
    """Layout and number of the vertices, if they come first and hold no list."""
    words = [line.split() for line in lines if line.startswith(("element", "property"))]
    if not words or words[0][:2] != ["element", "vertex"] or not re.fullmatch("[0-9]{1,18}", words[0][-1]):
        return None
    fields = []
    for word in words[1:]:
        if word[0] == "element":
            break
        if len(word) != 3 or word[1] not in _TYPES:
            return None
        fields.append((word[2], order + _TYPES[word[1]]))
    names = {name for name, _ in fields}
    if not {"x", "y", "z"} <= names or len(names) < len(fields):
        return None
    return np.dtype(fields), int(words[0][-1])
