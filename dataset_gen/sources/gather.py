"""Collects what a renderer receives: every object and instance, with modifiers at render settings.

A render engine of our own is run in place of Cycles. So visibility, excluded collections, instances,
particles, render levels of subdivision and all view layers are as they would be in the picture: Blender
itself decides.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np

from ..build import new_mesh

_SIDES = 4
_RADIUS = 0.005  # scene units; of curves that say nothing, as in Cycles
_LEFT_OUT = ("VOLUME", "GREASEPENCIL", "GPENCIL", "POINTCLOUD")  # kinds that have a look but no mesh


def tubes(points: np.ndarray, radius: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices [4P, 3] and quads [F, 4] of open tubes around strands.

    Parameters: `points` [P, 3] of all strands in a row, `radius` [P], `starts` [S + 1], where each begins.
    """
    strand = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    first, last = starts[:-1][strand], starts[1:][strand] - 1
    index = np.arange(len(points))
    along = points[np.minimum(index + 1, last)] - points[np.maximum(index - 1, first)]
    along = along / np.maximum(np.linalg.norm(along, axis=1), 1e-12)[:, None]
    # One reference direction for a whole strand, across it, keeps its tube from twisting.
    chord = points[starts[1:] - 1] - points[starts[:-1]]
    across = np.eye(3)[np.abs(chord).argmin(1)][strand]
    side = np.cross(along, across)
    side /= np.maximum(np.linalg.norm(side, axis=1), 1e-12)[:, None]
    up = np.cross(side, along)
    angle = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    ring = np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * up[:, None]
    vertices = (points[:, None] + radius[:, None, None] * ring).reshape(-1, 3)
    base = _SIDES * index[index < last][:, None]
    k = np.arange(_SIDES)
    after = (k + 1) % _SIDES
    quads = np.stack([base + k, base + after, base + _SIDES + after, base + _SIDES + k], -1)
    return vertices, quads.reshape(-1, 4)


def tube_mesh(name: str, points: np.ndarray, radius: np.ndarray, starts: np.ndarray) -> bpy.types.Mesh | None:
    """The tubes as a mesh; None where there is no strand of two points."""
    vertices, quads = tubes(points, radius, starts)
    if not len(quads):
        return None
    return new_mesh(name, vertices, quads)


def rest_positions(mesh: bpy.types.Mesh) -> np.ndarray:
    """Vertices [V, 3] float64, local."""
    flat = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", flat)
    return flat.reshape(-1, 3).astype(np.float64)


def curves_mesh(curves: bpy.types.Curves) -> bpy.types.Mesh | None:
    """Tubes along hair curves, as thick as their radius attribute says."""
    count = len(curves.points)
    points, radius = np.empty(3 * count, np.float32), np.full(count, _RADIUS, np.float32)
    curves.points.foreach_get("position", points)
    if "radius" in curves.attributes:
        curves.attributes["radius"].data.foreach_get("value", radius)
    starts = np.empty(len(curves.curves) + 1, np.int32)
    curves.curve_offset_data.foreach_get("value", starts)
    return tube_mesh(curves.name, points.reshape(-1, 3).astype(np.float64), radius, starts.astype(np.int64))


def particle_hair(obj: bpy.types.Object) -> Iterator[tuple[str, bpy.types.Mesh, int]]:
    """Name, tubes in the object's coordinates and material slot of every hair system that is rendered.

    Blender gives the points of a hair one by one, to Cycles as to us.
    """
    for modifier in obj.modifiers:
        if modifier.type != "PARTICLE_SYSTEM" or not modifier.show_render:
            continue
        system = modifier.particle_system
        how = system.settings
        if how.type != "HAIR" or how.render_type != "PATH":
            continue
        children, parents = len(system.child_particles), len(system.particles)
        virtual = parents if children and not how.use_parent_particles else 0
        steps = 2**how.render_step + 1
        points = np.array(
            [
                system.co_hair(object=obj, particle_no=i, step=step)
                for i in range(virtual, parents + children)
                for step in range(steps)
            ],
            np.float64,
        ).reshape(-1, 3)
        mesh = tube_mesh(system.name, *_local(obj, points, how, steps))
        if mesh is not None:
            yield system.name, mesh, max(how.material - 1, 0)


def _local(
    obj: bpy.types.Object, points: np.ndarray, how: bpy.types.ParticleSettings, steps: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points in the object's coordinates, radii from root to tip (thickness × scale / 2, as Cycles), starts."""
    inverse = np.linalg.pinv(np.array(obj.matrix_world, np.float64))
    local = points @ inverse[:3, :3].T + inverse[:3, 3]
    thickness = 0.5 * how.radius_scale * np.linspace(how.root_radius, how.tip_radius, steps)
    strands = len(points) // steps
    return local, np.tile(thickness, strands), np.arange(strands + 1) * steps


@dataclass(frozen=True, eq=False)
class SharedMesh:
    """A mesh in its own coordinates, shared by all pieces that show it."""

    mesh: bpy.types.Mesh  # evaluated, owned by nobody
    materials: tuple[bpy.types.Material | None, ...]  # one per slot
    generated: np.ndarray  # [V, 3] what a material reads as Generated coordinates


@dataclass(frozen=True, eq=False)
class Piece:
    """One appearance of a shape in the scene."""

    name: str  # of the object, or "instancer/object"; pieces of one name become one part
    shape: SharedMesh
    matrix: np.ndarray  # [4, 4] float64, local to world; may be mirrored or flattened
    source: bpy.types.Object  # the original
    random: float  # what a material reads as Object Info, Random
    seen: bool  # by the camera; False: it only lights, shadows or is mirrored


@dataclass(frozen=True, eq=False)
class Lamp:
    """A light as it stands in the scene."""

    name: str
    data: bpy.types.Light
    matrix: np.ndarray  # [4, 4] float64


@dataclass
class Gathered:
    """Everything that was found, in Blender's order."""

    pieces: list[Piece] = field(default_factory=list)
    lamps: list[Lamp] = field(default_factory=list)
    left_out: dict[str, set[str]] = field(default_factory=dict)  # kind → names
    error: BaseException | None = None
    _shapes: dict[tuple[Any, ...], SharedMesh | None] = field(default_factory=dict)
    _known: set[tuple[Any, ...]] = field(default_factory=set)

    def leave_out(self, kind: str, name: str) -> None:
        self.left_out.setdefault(kind, set()).add(name)


def gather(scene: bpy.types.Scene) -> Gathered:
    """Runs the engine over all view layers of the context's scene. Its engine and size are changed."""
    found = Gathered()

    class Engine(bpy.types.RenderEngine):
        bl_idname = "TG4MM_GATHER"
        bl_label = "Gather geometry"

        def render(self, depsgraph: bpy.types.Depsgraph) -> None:
            try:
                for instance in depsgraph.object_instances:
                    _take(found, instance, depsgraph)
            except BaseException as error:  # Blender would print it and go on
                found.error = error

    _prepare(scene)
    placeholder = bpy.data.objects.new("tg4mm gather", bpy.data.cameras.new("tg4mm gather"))
    scene.collection.objects.link(placeholder)
    scene.camera = placeholder  # Blender renders nothing without a camera; nothing is seen through it
    bpy.utils.register_class(Engine)
    try:
        scene.render.engine = Engine.bl_idname
        bpy.ops.render.render(scene=scene.name)
    finally:
        bpy.utils.unregister_class(Engine)
        bpy.data.objects.remove(placeholder)
    if found.error is not None:
        raise found.error
    return found


def _prepare(scene: bpy.types.Scene) -> None:
    render = scene.render
    render.resolution_x = render.resolution_y = 8
    render.resolution_percentage = 100
    render.use_simplify = render.use_border = render.use_multiview = render.use_motion_blur = False
    render.use_freestyle = render.use_compositing = render.use_sequencer = False
    render.use_single_layer = render.use_persistent_data = False
    for layer in scene.view_layers:
        layer.use_freestyle = False
    if not any(layer.use for layer in scene.view_layers):
        scene.view_layers[0].use = True


def _take(
    found: Gathered, instance: bpy.types.DepsgraphObjectInstance, depsgraph: bpy.types.Depsgraph
) -> None:
    obj, layer = instance.object, depsgraph.view_layer
    original = obj.original
    parent = instance.parent.original if instance.is_instance else None
    key = (original.session_uid, parent.session_uid if parent else 0, *instance.persistent_id)
    if (key, obj.type) in found._known:  # another view layer's
        return
    found._known.add((key, obj.type))
    matrix = np.array(instance.matrix_world, np.float64)
    if obj.type == "LIGHT" and instance.show_self:
        if not original.hide_render:
            found.lamps.append(Lamp(original.name, original.data, matrix))
    elif obj.type in _LEFT_OUT and instance.show_self:
        found.leave_out(obj.type.lower(), original.name)
    elif original.is_shadow_catcher or original.is_holdout or original.holdout_get(view_layer=layer):
        if obj.type == "MESH":
            found.leave_out("shadow catcher or holdout", original.name)
    else:
        for shape, suffix in _shapes_of(found, instance, depsgraph):
            name = _name(original, parent) + suffix
            number = instance.random_id if instance.is_instance else _number_of(original.name)
            random = (number & 0xFFFFFFFF) / 0xFFFFFFFF
            seen = original.visible_camera and not original.indirect_only_get(view_layer=layer)
            found.pieces.append(Piece(name, shape, matrix, original, random, seen))


def _number_of(name: str) -> int:
    """The number that Cycles gives an object by its name: Jenkins' hash of (hash of the letters, 0)."""
    letters = 0
    for byte in np.frombuffer(name.encode(), np.int8).tolist():
        letters = (37 * letters + byte) & 0xFFFFFFFF
    a = b = c = (0xDEADBEEF + (2 << 2) + 13) & 0xFFFFFFFF
    a = (a + letters) & 0xFFFFFFFF

    def mix(x: int, y: int, turn: int) -> int:
        turned = (y << turn | y >> (32 - turn)) & 0xFFFFFFFF
        return ((x ^ y) - turned) & 0xFFFFFFFF

    c = mix(c, b, 14)
    a = mix(a, c, 11)
    b = mix(b, a, 25)
    c = mix(c, b, 16)
    a = mix(a, c, 4)
    b = mix(b, a, 14)
    return mix(c, b, 24)


def _name(original: bpy.types.Object, parent: bpy.types.Object | None) -> str:
    if parent is None:
        return str(original.name)
    if parent == original:  # what a curve or text turned into, or what its nodes instanced
        return str(original.name) if original.type != "MESH" else f"{original.name}/instances"
    return f"{parent.name}/{original.name}"


def _shapes_of(
    found: Gathered, instance: bpy.types.DepsgraphObjectInstance, depsgraph: bpy.types.Depsgraph
) -> Iterator[tuple[SharedMesh, str]]:
    obj = instance.object
    if obj.type not in ("MESH", "CURVES"):
        return
    uid = (obj.original.session_uid, obj.data.as_pointer(), obj.type, depsgraph.view_layer.name)
    if instance.show_self:
        if uid not in found._shapes:
            found._shapes[uid] = _shape(obj, depsgraph)
        if (shape := found._shapes[uid]) is not None:
            yield shape, ""
    if obj.type == "MESH" and instance.show_particles and not instance.is_instance:
        for name, mesh, slot in particle_hair(obj):
            materials = _materials(obj, depsgraph)
            used = materials[slot : slot + 1] or (None,)
            yield SharedMesh(mesh, used, rest_positions(mesh)), f"/{name}"


def _shape(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> SharedMesh | None:
    if obj.type == "CURVES":
        mesh = curves_mesh(obj.data)
        generated = None if mesh is None else rest_positions(mesh)
    else:
        if not obj.data.polygons:
            return None
        if _is_own(obj, depsgraph):
            mesh = bpy.data.meshes.new_from_object(obj, preserve_all_data_layers=True, depsgraph=depsgraph)
        else:  # the other way would evaluate the object anew and give the object's own mesh
            mesh = bpy.data.meshes.new_from_object(obj)
        generated = _generated(obj.data)
    if mesh is None or generated is None:
        return None
    return SharedMesh(mesh, _materials(obj, depsgraph), generated)


def _is_own(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
    """Return whether a mesh is its object's evaluated mesh, not an instance from nodes or a converted curve."""
    own = obj.original.evaluated_get(depsgraph).data
    return own is not None and bool(own.as_pointer() == obj.data.as_pointer())


def _materials(
    obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph
) -> tuple[bpy.types.Material | None, ...]:
    """The material of every slot; a view layer's override takes the place of all."""
    override = depsgraph.view_layer.material_override
    slots = [slot.material for slot in obj.material_slots]
    if obj.type == "MESH" and not _is_own(obj, depsgraph) and len(obj.data.materials):
        slots = list(obj.data.materials)
    chosen = [override] * max(len(slots), 1) if override else slots
    return tuple(material.original if material else None for material in chosen)


def _generated(mesh: bpy.types.Mesh) -> np.ndarray:
    """Return [V, 3]: undeformed positions in the mesh's texture space, 0..1 over its bounding box."""
    undeformed = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("undeformed_co", undeformed)
    size = np.array(mesh.texspace_size, np.float64)
    size[size == 0] = 1.0
    return (undeformed.reshape(-1, 3) - np.array(mesh.texspace_location)) / (2.0 * size) + 0.5
