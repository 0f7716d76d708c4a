"""Inputs of a user's materials: missing images are found or replaced, coordinates are fixed to the surface.

A texture in object, generated or world coordinates would stay where it is while the surface vibrates
through it, and all of these change when an object is replaced by a mesh in world space. So they are written
into vertex attributes at rest, and the materials read those instead.
"""

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import bpy
import numpy as np

from ..build import DISPLACEMENT, LINEAR, new_image
from .gather import Piece

_DEPTH = 3  # folders below that of the file
_MOST = 20_000  # files that are looked at
_ENVIRONMENT = (0.25, 1.0)  # linear grey straight below and above, in place of a lost HDR
_ALIAS = "tg4mm user displacement"  # a user's attribute that has the name of ours

# Textures that read Generated coordinates where nothing is linked.
_PROCEDURAL = {
    f"ShaderNodeTex{kind}"
    for kind in ("Noise", "Voronoi", "Wave", "Magic", "Musgrave", "Gradient", "Checker", "Brick", "Gabor")
}
_LOCAL, _GENERATED, _WORLD = "tg4mm local", "tg4mm generated", "tg4mm world"
_LOCATION, _RANDOM = "tg4mm location", "tg4mm random"
_SCALARS = {_RANDOM}


def list_names(names: Iterable[str], most: int = 6) -> str:
    """Names in order for a warning, the tail counted."""
    ordered = sorted(names)
    shown = ", ".join(ordered[:most])
    return shown if len(ordered) <= most else f"{shown} and {len(ordered) - most} more"


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
    """Return why an image cannot be shown; "" if it can."""
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


@dataclass
class Anchors:
    """The attributes that the rewritten materials read."""

    needed: set[str] = field(default_factory=set)
    frames: dict[str, np.ndarray] = field(default_factory=dict)  # attribute → world to an object's axes
    unanchored: set[str] = field(default_factory=set)  # what still reads from space

    def rewrite(self, tree: bpy.types.NodeTree) -> None:
        """Replaces what reads from space in one node tree; groups inside are the caller's."""
        for node in list(tree.nodes):
            kind = node.bl_idname
            if kind == "ShaderNodeTexCoord":
                self._replace(tree, node.outputs["Generated"], _GENERATED)
                self._replace(tree, node.outputs["Object"], self._frame(node.object))
            elif kind == "ShaderNodeNewGeometry":
                self._replace(tree, node.outputs["Position"], _WORLD)
            elif kind == "ShaderNodeObjectInfo":
                self._replace(tree, node.outputs["Location"], _LOCATION)
                self._replace(tree, node.outputs["Random"], _RANDOM)
            elif kind in _PROCEDURAL and not node.inputs["Vector"].is_linked:
                tree.links.new(self._attribute(tree, _GENERATED), node.inputs["Vector"])
            elif kind == "ShaderNodeAttribute" and node.attribute_name == DISPLACEMENT:
                node.attribute_name = _ALIAS
            elif kind == "ShaderNodeVectorTransform" and "OBJECT" in (node.convert_from, node.convert_to):
                self.unanchored.add("Vector Transform from or to object space")
            elif kind == "ShaderNodeParticleInfo":
                self.unanchored.add("Particle Info")

    def _frame(self, obj: bpy.types.Object | None) -> str:
        if obj is None:
            return _LOCAL
        name = f"tg4mm in {obj.name}"
        self.frames[name] = np.linalg.pinv(np.array(obj.matrix_world, np.float64))
        return name

    def _attribute(self, tree: bpy.types.NodeTree, name: str) -> bpy.types.NodeSocket:
        self.needed.add(name)
        node = tree.nodes.new("ShaderNodeAttribute")
        node.attribute_name = name
        return node.outputs["Fac" if name in _SCALARS else "Vector"]

    def _replace(self, tree: bpy.types.NodeTree, output: bpy.types.NodeSocket, name: str) -> None:
        targets = [link.to_socket for link in output.links]
        if targets:
            source = self._attribute(tree, name)
            for target in targets:
                tree.links.new(source, target)

    def write(
        self, mesh: bpy.types.Mesh, pieces: Sequence[Piece], local: np.ndarray, world: np.ndarray
    ) -> None:
        """Writes what is needed on a mesh made of pieces of one shape, one after the other.

        `local` and `world` [V, 3] are its vertices in the two frames.
        """
        _free_the_name(mesh)
        each = len(world) // len(pieces)
        values: dict[str, Callable[[], np.ndarray]] = {
            _LOCAL: lambda: local,
            _GENERATED: lambda: np.tile(pieces[0].shape.generated, (len(pieces), 1)),
            _WORLD: lambda: world,
            _LOCATION: lambda: np.repeat([piece.matrix[:3, 3] for piece in pieces], each, 0),
            _RANDOM: lambda: np.repeat([piece.random for piece in pieces], each),
        }
        for name in sorted(self.needed):
            if name in self.frames:
                frame = self.frames[name]
                value = world @ frame[:3, :3].T + frame[:3, 3]
            else:
                value = values[name]()
            kind = "FLOAT" if name in _SCALARS else "FLOAT_VECTOR"
            data = mesh.attributes.new(name, kind, "POINT").data
            data.foreach_set("value" if name in _SCALARS else "vector", value.astype(np.float32).ravel())


def _free_the_name(mesh: bpy.types.Mesh) -> None:
    """Our displacement takes its name; a user's attribute of that name gets another."""
    if (clash := mesh.attributes.get(DISPLACEMENT)) is not None:
        clash.name = _ALIAS


def own_groups(tree: bpy.types.NodeTree, copies: dict[bpy.types.NodeTree, bpy.types.NodeTree]) -> None:
    """Gives a tree copies of its groups, shared through `copies`: a linked library's cannot be changed."""
    for node in tree.nodes:
        group = getattr(node, "node_tree", None)
        if group is None or group in copies.values():
            continue
        if group not in copies:
            copies[group] = group.copy()
            copies[group].animation_data_clear()
            own_groups(copies[group], copies)
        node.node_tree = copies[group]
