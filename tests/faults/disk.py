"""A disk that is full."""

from __future__ import annotations

import os
from pathlib import Path


def fill(folder: Path, leave: int = 0) -> None:
    """Fill the file system but for `leave` bytes."""
    room = os.statvfs(folder)
    (folder / "filler").write_bytes(b"\1" * (room.f_bavail * room.f_frsize - leave))
