"""PNG files without what Blender adds to them: dates and render times, which differ from run to run."""

from __future__ import annotations

import os
import struct
from pathlib import Path

_HEAD = b"\x89PNG\r\n\x1a\n"
_TAIL = b"IEND\xaeB`\x82"
_KEPT = (b"IHDR", b"IDAT", b"IEND")


def essential(data: bytes) -> bytes:
    """The same picture with its header and pixels only. Raises ValueError if `data` is not a whole PNG."""
    if not (data.startswith(_HEAD) and data.endswith(_TAIL)):
        raise ValueError("not a whole PNG file")
    kept, at = [_HEAD], len(_HEAD)
    while at < len(data):
        length = struct.unpack_from(">I", data, at)[0] + 12  # length, name, content, checksum
        if data[at + 4 : at + 8] in _KEPT:
            kept.append(data[at : at + length])
        at += length
    return b"".join(kept)


def complete(path: Path, width: int, height: int) -> bool:
    """True for an 8-bit RGBA PNG of this size that ends as PNGs do; reads its first and last bytes only."""
    try:
        with path.open("rb") as file:
            head = file.read(26)
            file.seek(-len(_TAIL), os.SEEK_END)
            tail = file.read()
    except OSError:
        return False
    return head == _HEAD + struct.pack(">I4sIIBB", 13, b"IHDR", width, height, 8, 6) and tail == _TAIL
