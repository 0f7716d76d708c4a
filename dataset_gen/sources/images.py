"""Lost images of a user's file, replaced by neutral ones."""

from __future__ import annotations

import os
from collections.abc import Iterable

import bpy
import numpy as np

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
    """A soft grey environment, brighter above."""
    if (known := bpy.data.images.get("tg4mm grey sky")) is not None:
        return known
    height = 32
    ramp = np.linspace(*_ENVIRONMENT, height)
    return _image("tg4mm grey sky", np.broadcast_to(ramp[:, None, None], (height, 2 * height, 3)), True)


def _neutral(node: bpy.types.Node) -> bpy.types.Image:
    """Middle grey; straight up where it feeds a normal map."""
    normal = any(link.to_node.bl_idname == "ShaderNodeNormalMap" for link in node.outputs["Color"].links)
    name, colour = ("tg4mm flat", (0.5, 0.5, 1.0)) if normal else ("tg4mm neutral", (0.5, 0.5, 0.5))
    known = bpy.data.images.get(name)
    return known if known is not None else _image(name, np.broadcast_to(colour, (4, 4, 3)), False)


def _image(name: str, pixels: np.ndarray, linear: bool) -> bpy.types.Image:
    height, width = pixels.shape[:2]
    image = bpy.data.images.new(name, width, height, alpha=False, float_buffer=linear)
    image.colorspace_settings.name = "Linear Rec.709" if linear else "Non-Color"
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = pixels
    image.pixels.foreach_set(rgba.ravel())
    image.update()
    image.pack()
    return image
