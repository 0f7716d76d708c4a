"""Finds image files that a .blend names by a path of another machine, near the .blend by their names."""

from __future__ import annotations

import os
from pathlib import Path

import bpy

from .names import list_names

_DEPTH = 3  # folders below that of the file
_MOST = 20_000  # files that are looked at


def find_images(folder: Path) -> list[str]:
    """Points images whose files are missing to ones of the same name, letter case aside, in or below `folder`.

    Returns one line for all that were found so; images that were not found are left as they are.
    """
    lost = [image for image in bpy.data.images if _is_lost(image)]
    if not lost:
        return []
    near = _files(folder)
    found = []
    for image in lost:
        name = image.filepath.replace("\\", "/").rsplit("/", 1)[-1].lower()
        if (path := near.get(name)) is not None:
            image.filepath = str(path)
            image.reload()
            found.append(path.name)
    return [f"images found by their names near the file: {list_names(found)}"] if found else []


def _is_lost(image: bpy.types.Image) -> bool:
    if image.source not in ("FILE", "SEQUENCE", "MOVIE") or image.packed_file or not image.filepath:
        return False
    return not os.path.isfile(bpy.path.abspath(image.filepath, library=image.library))


def _files(folder: Path) -> dict[str, Path]:
    """Lower-case name → file; of several, the one nearest to the top, then first by name."""
    found: dict[str, Path] = {}
    count, level = 0, [folder]
    for _ in range(_DEPTH + 1):
        below: list[Path] = []
        for place in level:
            try:
                entries = sorted(os.scandir(place), key=lambda entry: entry.name)
            except OSError:
                continue
            for entry in entries:
                count += 1
                if count > _MOST:
                    return found
                if entry.is_dir(follow_symlinks=False):
                    below.append(Path(entry.path))
                else:
                    found.setdefault(entry.name.lower(), Path(entry.path))
        level = below
    return found
