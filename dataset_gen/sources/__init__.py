"""The user's own geometry: a .blend file or a mesh file, as a stage that the generator can move."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .assemble import LoadedScene


def open_blend(path: Path, *, frame: int | None = None, scene: str | None = None) -> LoadedScene:
    """See `blend.open_blend`."""
    from .blend import open_blend

    return open_blend(path, frame=frame, scene=scene)


def open_mesh(path: Path) -> LoadedScene:
    """See `mesh_file.open_mesh`."""
    from .mesh_file import open_mesh

    return open_mesh(path)
