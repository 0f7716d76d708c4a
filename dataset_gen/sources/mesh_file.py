"""Opens a mesh file (glTF, OBJ, PLY, STL, USD, FBX) as a stage: centred, of a fixed size, softly lit."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Vector

from ..build import trees
from ..build import world as made_world
from ..cameras import scene_cameras
from ..errors import GenerateError
from ..scene import Gradient
from .assemble import LoadedScene, Origin, assemble
from .blend import file_cameras
from .gather import Gathered, Piece, gather, rest_positions
from .images import find_images

RADIUS = 1.2  # scene units, of the sphere around the object after scaling
_SKY = Gradient(((0.18, 0.17, 0.16), (0.4, 0.41, 0.43), (0.6, 0.64, 0.72)))
_LAMP_AT, _LAMP_SIZE, _LAMP_POWER = (3.2, -2.4, 4.0), 2.5, 200.0  # scene units, watts as Blender counts
_GREY = (0.45, 0.45, 0.45, 1.0)  # linear
_SHOWS_DETAIL = ("ShaderNodeTex", "ShaderNodeAttribute", "ShaderNodeVertexColor")

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"), **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"), **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"), **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"), **dict.fromkeys(("double", "float64"), "f8"),
}  # fmt: skip
_HEADER = re.compile(rb"ply\r?\n.*?end_header\r?\n", re.S)
_LONGEST = 1 << 16  # bytes of a header
_NO_NUMBER = re.compile(rb"(?<![\w.])[+-]?(?:nan|inf)", re.I)


@dataclass(frozen=True)
class _Format:
    operator: str  # of bpy.ops
    addon: str = ""  # that brings the operator along
    metres: bool = False  # whether the format fixes the unit of length, which the importer turns into metres
    validation: str = ""  # option by which the importer hides vertices that are not finite


_GLTF = _Format("import_scene.gltf", "io_scene_gltf2", metres=True)
_USD = _Format("wm.usd_import", metres=True)
_FORMATS = {
    ".glb": _GLTF, ".gltf": _GLTF, ".obj": _Format("wm.obj_import", validation="validate_meshes"),
    ".ply": _Format("wm.ply_import"), ".stl": _Format("wm.stl_import", validation="use_mesh_validate"),
    ".usd": _USD, ".usda": _USD, ".usdc": _USD, ".usdz": _USD,
    ".fbx": _Format("wm.fbx_import", validation="validate_meshes"),
}  # fmt: skip
_OLD_FBX = _Format("import_scene.fbx", "io_scene_fbx")


def open_mesh(path: Path) -> LoadedScene:
    """Takes over this process's Blender session with a mesh file, through Blender's own importer.

    The object is centred and scaled so that a sphere of radius 1.2 around its bounding box's centre just holds
    it; the file's lights give way to a soft light and a sky. Raises GenerateError, one line, if the file
    cannot be used.
    """
    path = path.absolute()
    format_ = _format_of(path)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    _import(path, format_)
    scene = bpy.context.scene
    warnings = find_images(path.parent)
    names, cameras = file_cameras(scene, warnings)
    found = gather(scene)
    found.lamps.clear()
    if not found.pieces:
        raise GenerateError(f"{path} holds no surface: the importer found {_census()}")
    _colour(found, warnings)
    scale, centre = _fit(path, found)
    found.pieces[:] = [_fitted(piece, scale, centre) for piece in found.pieces]
    poses = [_fitted_matrix(camera.camera_to_world, scale, centre, turn_only=True) for camera in cameras]
    cameras = scene_cameras(poses, [c.angle_x for c in cameras], [c.shift for c in cameras])
    metres = 1.0 / scale if format_.metres else None
    own = ("m" if format_.metres else f"units of {path.name}", 1.0 / scale)
    origin = Origin(path, metres, own, cameras, names)
    return assemble(found, scene, origin, _light, warnings)


def _format_of(path: Path) -> _Format:
    format_ = _FORMATS.get(path.suffix.lower())
    if format_ is None:
        known = ", ".join(sorted(_FORMATS))
        raise GenerateError(f"{path}: extension {path.suffix!r} is not one of {known}")
    if not path.is_file():
        raise GenerateError(f"{path} {'is not a file' if path.exists() else 'does not exist'}")
    if path.stat().st_size == 0:
        raise GenerateError(f"{path} is empty")
    return format_ if _operator(format_) or format_.operator != "wm.fbx_import" else _OLD_FBX


def _operator(format_: _Format) -> Callable[..., Any] | None:
    module, name = format_.operator.split(".")
    submodule = getattr(bpy.ops, module)
    return getattr(submodule, name) if name in dir(submodule) else None


def _import(path: Path, format_: _Format) -> None:
    if format_.addon and _operator(format_) is None:
        import addon_utils

        addon_utils.enable(format_.addon)
    operator = _operator(format_)
    if operator is None:
        raise GenerateError(f"{path}: this Blender cannot read {path.suffix} (no {format_.operator})")
    if path.suffix.lower() == ".ply" and (bad := count_not_finite(path)):
        raise GenerateError(f"{path}: {bad} of its vertices are not finite numbers")
    try:
        status = operator(filepath=str(path), **({format_.validation: False} if format_.validation else {}))
    except (RuntimeError, OSError, ValueError) as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        # A traceback says what went wrong in its last line, a report in its first.
        line = (lines[-1] if "Traceback" in str(error) else lines[0]) if lines else type(error).__name__
        raise GenerateError(f"{path} cannot be imported: {line.removeprefix('Error: ')}") from None
    if status != {"FINISHED"}:
        raise GenerateError(f"{path} cannot be imported: Blender's importer failed")
    for mesh in bpy.data.meshes:
        if not np.isfinite(rest_positions(mesh)).all():
            raise GenerateError(f"{path}: mesh {mesh.name} has vertices that are not finite numbers")
        mesh.validate()


def _census() -> str:
    kinds = [obj.type.lower() for obj in bpy.data.objects]
    return ", ".join(f"{kinds.count(kind)} {kind}" for kind in sorted(set(kinds))) or "nothing"


def _fit(path: Path, found: Gathered) -> tuple[float, np.ndarray]:
    """Scale to the fixed radius, and the centre of the bounding box [3] in the file's units."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    places = []
    for piece in found.pieces:
        world = rest_positions(piece.shape.mesh) @ piece.matrix[:3, :3].T + piece.matrix[:3, 3]
        low, high = np.minimum(low, world.min(0)), np.maximum(high, world.max(0))
        places.append(world)
    centre = 0.5 * (low + high)
    radius = max(float(np.linalg.norm(world - centre, axis=1).max()) for world in places)
    if not radius > 0:
        raise GenerateError(f"{path}: all vertices lie in one point, {centre.tolist()}")
    return RADIUS / radius, centre


def _fitted(piece: Piece, scale: float, centre: np.ndarray) -> Piece:
    return replace(piece, matrix=_fitted_matrix(piece.matrix, scale, centre))


def _fitted_matrix(
    matrix: np.ndarray, scale: float, centre: np.ndarray, turn_only: bool = False
) -> np.ndarray:
    """A placement [4, 4] in the fitted scene; `turn_only` leaves its axes as long as they are."""
    fitted = np.array(matrix, np.float64)
    fitted[:3, :3] *= 1.0 if turn_only else scale
    fitted[:3, 3] = scale * (fitted[:3, 3] - centre)
    return fitted


def _colour(found: Gathered, warnings: list[str]) -> None:
    """Gives pieces without material their vertex colours, or grey; warns if nothing has any detail."""
    made: dict[str, bpy.types.Material] = {}
    coloured = False
    shapes = {id(piece.shape): piece.shape for piece in found.pieces}
    dressed = {}
    for key, shape in shapes.items():
        materials = shape.materials
        if not any(materials):
            colours = shape.mesh.color_attributes
            layer = colours[max(colours.render_color_index, 0)].name if len(colours) else ""
            made.setdefault(layer, _material_of(layer))
            materials = (made[layer],)
        dressed[key] = replace(shape, materials=materials)
        coloured = coloured or _has_detail(materials)
    found.pieces[:] = [replace(piece, shape=dressed[id(piece.shape)]) for piece in found.pieces]
    if not coloured:
        warnings.append("no texture and no vertex colours: motion along a plain surface will be hard to see")


def _material_of(layer: str) -> bpy.types.Material:
    material = bpy.data.materials.new(layer or "grey")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    tree = material.node_tree
    shader = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
    shader.inputs["Base Color"].default_value = _GREY
    if layer:
        colour = tree.nodes.new("ShaderNodeVertexColor")
        colour.layer_name = layer
        tree.links.new(colour.outputs["Color"], shader.inputs["Base Color"])
    return material


def _has_detail(materials: Sequence[bpy.types.Material | None]) -> bool:
    roots = [material.node_tree for material in materials if material is not None]
    return any(node.bl_idname.startswith(_SHOWS_DETAIL) for tree in trees(roots) for node in tree.nodes)


def _light(scene: bpy.types.Scene, old: bpy.types.Scene, lit: bool, warnings: list[str]) -> None:
    scene.world = made_world(_SKY)
    data = bpy.data.lights.new("soft box", "AREA")
    data.size, data.energy = _LAMP_SIZE, _LAMP_POWER
    lamp = bpy.data.objects.new("soft box", data)
    lamp.location = _LAMP_AT
    lamp.rotation_euler = (-Vector(_LAMP_AT)).to_track_quat("-Z", "Y").to_euler()
    scene.collection.objects.link(lamp)


def count_not_finite(path: Path) -> int:
    """Return the number of vertices with a non-finite coordinate; 0 for layouts that cannot be read here.

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
