"""Lost images of a user's file: found by name near it, else replaced by neutral ones; and how warnings list names."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

import bpy
import numpy as np

from ..build import LINEAR, new_image


def list_names(names: Iterable[str], most: int = 6) -> str:
    """Names in order for a warning, the tail counted."""
    ordered = sorted(names)
    shown = ", ".join(ordered[:most])
    return shown if len(ordered) <= most else f"{shown} and {len(ordered) - most} more"


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
        for folder_ in level:
            try:
                entries = sorted(os.scandir(folder_), key=lambda entry: entry.name)
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


_ENVIRONMENT = (0.25, 1.0)  # linear grey straight below and above, in place of a lost HDR


def repair_images(all_trees: Iterable[bpy.types.NodeTree]) -> list[str]:
    """Replaces lost images by neutral ones. Returns a warning for each."""
    warnings: dict[str, None] = {}
    for tree in all_trees:
        for node in tree.nodes:
            if node.bl_idname not in ("ShaderNodeTexImage", "ShaderNodeTexEnvironment"):
                continue
            why = _lost(node.image)
            if why and (node.image is not None or node.outputs[0].links):
                environment = node.bl_idname == "ShaderNodeTexEnvironment"
                node.image = _grey_sky() if environment else _neutral(node)
                what = "a grey sky of similar strength" if environment else "plain grey"
                warnings[f"{why}: {what} takes its place"] = None
    return list(warnings)


def _lost(image: bpy.types.Image | None) -> str:
    """Why an image cannot be shown; "" if it can."""
    if image is None:
        return "a texture has no image"
    if image.source not in ("FILE", "SEQUENCE", "TILED", "MOVIE") or image.packed_file:
        return ""
    path = bpy.path.abspath(image.filepath_from_user(), library=image.library)
    if image.source != "TILED" and not os.path.isfile(path):
        return f"image {image.name}: {image.filepath or 'its file'} is missing"
    if image.source in ("FILE", "TILED") and 0 in image.size:
        return f"image {image.name}: {image.filepath} cannot be read"
    image.buffers_free()
    return ""


def _grey_sky() -> bpy.types.Image:
    if (known := bpy.data.images.get("tg4mm grey sky")) is not None:
        return known
    height = 32
    ramp = np.linspace(*_ENVIRONMENT, height)
    return _image("tg4mm grey sky", np.broadcast_to(ramp[:, None, None], (height, 2 * height, 3)), LINEAR)


def _neutral(node: bpy.types.Node) -> bpy.types.Image:
    """Middle grey; straight up where it feeds a normal map."""
    normal = any(link.to_node.bl_idname == "ShaderNodeNormalMap" for link in node.outputs["Color"].links)
    name, colour = ("tg4mm flat", (0.5, 0.5, 1.0)) if normal else ("tg4mm neutral", (0.5, 0.5, 0.5))
    known = bpy.data.images.get(name)
    return known if known is not None else _image(name, np.broadcast_to(colour, (4, 4, 3)), "Non-Color")


def _image(name: str, pixels: np.ndarray, space: str) -> bpy.types.Image:
    image = new_image(name, pixels, space)
    image.pack()
    return image
