"""Convert gathered pieces to plain mesh objects in world space, one per part of the scene."""

from collections.abc import Sequence

import bpy
import numpy as np

from ..errors import GenerateError
from .copies import MaterialCopies
from .gather import Piece, rest_positions
from .images import Anchors

_RAYS = ("diffuse", "glossy", "transmission", "volume_scatter", "shadow")


def realise(
    pieces: Sequence[Piece], scene: bpy.types.Scene, copies: MaterialCopies, anchors: Anchors
) -> list[tuple[str, bpy.types.Object, bool]]:
    """Objects with identity transform and a mesh of their own: name, object, whether the camera sees it.

    Pieces of one name become one object. Vertices keep the order they were evaluated in, pieces of one shape
    Blender's order. Raises GenerateError for vertices that are not finite.
    """
    for piece in pieces:  # all materials first: they tell which attributes are needed
        for material in piece.shape.materials or (None,):
            copies.material(material)
    named: dict[tuple[str, bool], list[Piece]] = {}
    for piece in pieces:
        if any(copies.material(m) is not None for m in piece.shape.materials or (None,)):
            named.setdefault((piece.name, piece.seen), []).append(piece)
    made = []
    for (name, seen), group in named.items():
        alike = _alike(group).values()
        objects = [_object(name, _place(same, scene, copies, anchors), scene) for same in alike]
        joined = _join(objects)
        _look_as(joined, group, seen)
        made.append((name, joined, seen))
    return made


def _object(name: str, mesh: bpy.types.Mesh, scene: bpy.types.Scene) -> bpy.types.Object:
    obj = bpy.data.objects.new(name, mesh)
    scene.collection.objects.link(obj)
    return obj


def _join(objects: list[bpy.types.Object]) -> bpy.types.Object:
    """All objects as the first one, with what any of them has: slots, maps, colours, groups."""
    first = objects[0]
    if len(objects) > 1:
        with bpy.context.temp_override(
            active_object=first, object=first, selected_objects=objects, selected_editable_objects=objects
        ):
            bpy.ops.object.join()
    return first


def _look_as(obj: bpy.types.Object, group: list[Piece], seen: bool) -> None:
    """Copy the original object's properties that affect the picture, apart from its mesh."""
    source = group[0].source
    obj.color, obj.pass_index = source.color, source.pass_index
    obj.visible_camera = seen
    for ray in _RAYS:
        setattr(obj, f"visible_{ray}", getattr(source, f"visible_{ray}"))
    for key, value in source.items():  # custom properties, which materials can read
        if isinstance(value, int | float | str) or hasattr(value, "to_list"):
            obj[key] = value


def _alike(group: Sequence[Piece]) -> dict[tuple[int, bool], list[Piece]]:
    """Pieces by shape and by whether they are mirrored, so that each lot is placed at once."""
    found: dict[tuple[int, bool], list[Piece]] = {}
    for piece in group:
        mirrored = bool(np.linalg.det(piece.matrix[:3, :3]) < 0)
        found.setdefault((id(piece.shape), mirrored), []).append(piece)
    return found


def _place(
    pieces: Sequence[Piece], scene: bpy.types.Scene, copies: MaterialCopies, anchors: Anchors
) -> bpy.types.Mesh:
    """One mesh of all pieces, which are alike, in world space, dressed and anchored."""
    base = pieces[0].shape.mesh
    mesh = base.copy() if len(pieces) == 1 else _repeated(base, len(pieces), scene)
    _dress(mesh, pieces[0], copies)
    local = rest_positions(base)
    _check_finite(pieces[0].name, local)
    world = np.concatenate([local @ piece.matrix[:3, :3].T + piece.matrix[:3, 3] for piece in pieces])
    anchors.write(mesh, pieces, np.tile(local, (len(pieces), 1)), world)
    normals = _corner_normals(base, pieces) if base.has_custom_normals else None
    if np.linalg.det(pieces[0].matrix[:3, :3]) < 0:
        normals = None if normals is None else normals[_flipped_corners(mesh)]
        mesh.flip_normals()
    mesh.vertices.foreach_set("co", world.astype(np.float32).ravel())
    mesh.update()
    if normals is not None:
        mesh.normals_split_custom_set(normals)
    return mesh


def _repeated(base: bpy.types.Mesh, count: int, scene: bpy.types.Scene) -> bpy.types.Mesh:
    """The mesh `count` times over in one, with all it carries: joining objects one by one is far slower."""
    obj = _object("tg4mm repeat", base, scene)
    array = obj.modifiers.new("repeat", "ARRAY")
    array.fit_type, array.count = "FIXED_COUNT", count
    array.use_relative_offset, array.use_merge_vertices = False, False
    depsgraph = bpy.context.evaluated_depsgraph_get()
    made = bpy.data.meshes.new_from_object(
        obj.evaluated_get(depsgraph), preserve_all_data_layers=True, depsgraph=depsgraph
    )
    bpy.data.objects.remove(obj)
    return made


def _dress(mesh: bpy.types.Mesh, piece: Piece, copies: MaterialCopies) -> None:
    """Our materials in every slot; a slot without one, and a mesh without slots, get plain grey."""
    grey = copies.material(None)
    slots = [copies.material(m) or grey for m in piece.shape.materials] or [grey]
    for i, material in enumerate(slots):
        if i < len(mesh.materials):
            mesh.materials[i] = material
        else:
            mesh.materials.append(material)
    while len(mesh.materials) > len(slots):
        mesh.materials.pop(index=len(mesh.materials) - 1)


def _corner_normals(mesh: bpy.types.Mesh, pieces: Sequence[Piece]) -> np.ndarray | None:
    """Custom normals [pieces · L, 3] in world space; None where a piece is flattened."""
    flat = np.empty(3 * len(mesh.loops), np.float32)
    mesh.corner_normals.foreach_get("vector", flat)
    turned = []
    for piece in pieces:
        linear = piece.matrix[:3, :3]
        if abs(np.linalg.det(linear)) <= 1e-12 * max(np.abs(linear).max(), 1e-30) ** 3:
            return None
        turned.append(flat.reshape(-1, 3) @ np.linalg.inv(linear))
    normals = np.concatenate(turned)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.where(length > 0, length, 1.0))


def _flipped_corners(mesh: bpy.types.Mesh) -> np.ndarray:
    """Return the corner order [L] of flipped faces: the first corner stays, the others are reversed."""
    starts, sizes = np.empty((2, len(mesh.polygons)), np.int32)
    mesh.polygons.foreach_get("loop_start", starts)
    mesh.polygons.foreach_get("loop_total", sizes)
    start, size = np.repeat(starts, sizes), np.repeat(sizes, sizes)
    offset = np.arange(len(start)) - start
    return start + np.where(offset == 0, 0, size - offset)


def _check_finite(name: str, vertices: np.ndarray) -> None:
    """Raises GenerateError if a vertex [V, 3] is not a place."""
    bad = ~np.isfinite(vertices).all(1)
    if bad.any():
        first = int(bad.argmax())
        raise GenerateError(
            f"object {name}: vertex {first} lies at {vertices[first].tolist()}, one of {int(bad.sum())} that "
            "are not finite"
        )
