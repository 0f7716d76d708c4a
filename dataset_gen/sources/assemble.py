"""Assemble a stage from gathered pieces: a new scene with plain meshes, lights and world only."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ..build import Stage, stage_of, trees
from ..cameras import SceneCamera
from ..errors import GenerateError
from ..vibration.fields import Body
from .bodies_file import FileContents
from .copies import MaterialCopies, brighten, glows
from .gather import Gathered, Lamp, rest_positions
from .images import Anchors, list_names
from .realise import realise

_FLAT = 0.02  # thickness over width
_BACKDROP = 4.0  # a part this many times as wide as all others together is not what is looked at
# Lights the new scene, given the old one, whether the file's lights or materials give light, and the warnings.
Lighting = Callable[[bpy.types.Scene, bpy.types.Scene, bool, list[str]], None]
_TARGET = "tg4mm weight {}"


@dataclass(frozen=True)
class LoadedScene(FileContents):
    """A user's scene, at rest, in the Blender session of this process."""

    stage: Stage  # its `objects` and `rest` go with `bodies`, one to one


@dataclass(frozen=True)
class Origin:
    """Information about a file other than its geometry."""

    path: Path
    unit_scale_m: float | None  # metres per scene unit
    own_unit: tuple[str, float]  # of the file: its name, and how many of it a scene unit is
    cameras: tuple[SceneCamera, ...] = ()
    camera_names: tuple[str, ...] = ()
    exposure: float = 1.0  # factor on all light


def assemble(
    found: Gathered, old: bpy.types.Scene, origin: Origin, light: Lighting, warnings: Sequence[str]
) -> LoadedScene:
    """Builds the stage and empties the session of all else. Raises GenerateError if nothing is to be seen."""
    notes = list(warnings)
    notes += [f"left out, {kind}: {list_names(names)}" for kind, names in sorted(found.left_out.items())]
    if not any(piece.seen for piece in found.pieces):
        raise GenerateError(f"{origin.path}: nothing in scene {old.name!r} is a surface that renders")
    bpy.ops.scene.new(type="NEW")
    scene = bpy.context.scene
    anchors = Anchors()
    copies = MaterialCopies(anchors, notes)
    made = realise(found.pieces, scene, copies, anchors)
    objects = {name: obj for name, obj, seen in made if seen}
    if not objects:
        raise GenerateError(f"{origin.path}: scene {old.name!r} holds nothing but volumes")
    copies.report()
    lamps = [(lamp.name, _lamp(lamp, scene, origin.exposure)) for lamp in found.lamps]
    lit = any(lamp.data.energy > 0 for lamp in found.lamps) or glows(copies.made)
    light(scene, old, lit, notes)
    if origin.exposure != 1.0:
        roots = [block.node_tree for block in (scene.world, *copies.made)]
        brighten(trees(roots), origin.exposure)
    _remove_all_but(scene)
    for name, obj in [*lamps, *((name, obj) for name, obj, _ in made)]:
        obj.name = name  # the user's object had it until now
    copies.rename()
    bodies = _bodies(objects)
    centre, radius = _bounds(bodies, notes)
    stage = stage_of(scene, tuple(objects.values()), tuple(body.vertices for body in bodies))
    stage.camera.data.clip_end = max(100.0, 100.0 * radius)
    stage.camera.data.clip_start = min(0.01, 0.002 * radius)
    return LoadedScene(
        bodies, origin.unit_scale_m, origin.own_unit, origin.cameras, origin.camera_names, tuple(notes), centre, radius,
        stage,
    )  # fmt: skip


def _lamp(lamp: Lamp, scene: bpy.types.Scene, exposure: float) -> bpy.types.Object:
    data = lamp.data.copy()
    data.animation_data_clear()
    data.energy *= exposure
    if data.node_tree is not None:
        data.node_tree.animation_data_clear()
    obj = bpy.data.objects.new(lamp.name, data)
    obj.matrix_world = Matrix(lamp.matrix.tolist())
    scene.collection.objects.link(obj)
    return obj


def _remove_all_but(scene: bpy.types.Scene) -> None:
    """Removes what could still move, play, run or be shown: other scenes, objects, texts, actions."""
    for other in list(bpy.data.scenes):
        if other != scene:
            bpy.data.scenes.remove(other)
    keep = set(scene.objects)
    bpy.data.batch_remove([obj for obj in bpy.data.objects if obj not in keep])
    for blocks in (bpy.data.collections, bpy.data.texts, bpy.data.actions, bpy.data.libraries):
        bpy.data.batch_remove(list(blocks))
    bpy.data.orphans_purge(do_local_ids=True, do_linked_ids=True, do_recursive=True)


def _bodies(objects: Mapping[str, bpy.types.Object]) -> tuple[Body, ...]:
    bodies = []
    weights = group_weights(tuple(objects.values()))
    for (name, obj), groups in zip(objects.items(), weights, strict=True):
        mesh = obj.data
        mesh.calc_loop_triangles()
        triangles = np.empty(3 * len(mesh.loop_triangles), np.int32)
        mesh.loop_triangles.foreach_get("vertices", triangles)
        vertices = rest_positions(mesh)
        bodies.append(Body(name, vertices, triangles.reshape(-1, 3), np.ones(len(vertices)), groups))
    return tuple(bodies)


def _bounds(bodies: Sequence[Body], notes: list[str]) -> tuple[tuple[float, float, float], float]:
    """Centre and radius of a sphere around the parts; a floor or dome much wider than the rest is not counted."""
    by_width = sorted(bodies, key=_width)
    counted = by_width[:1]
    backdrops: list[Body] = []
    for body in by_width[1:]:
        (backdrops if _is_backdrop(body, counted) else counted).append(body)
    if backdrops:
        names = list_names(body.name for body in backdrops)
        notes.append(f"cameras look at the scene without {names}, far wider than the rest")
    low, high = _box(counted)
    centre = 0.5 * (low + high)
    radius = max(float(np.linalg.norm(body.vertices - centre, axis=1).max()) for body in counted)
    return (float(centre[0]), float(centre[1]), float(centre[2])), radius


def _box(bodies: Sequence[Body]) -> tuple[np.ndarray, np.ndarray]:
    return np.min([body.vertices.min(0) for body in bodies], 0), np.max(
        [b.vertices.max(0) for b in bodies], 0
    )


def _width(body: Body) -> float:
    low, high = _box([body])
    return float(np.linalg.norm(high - low))


def _is_backdrop(body: Body, rest: Sequence[Body]) -> bool:
    """A floor or wall (flat), or a dome (of few faces, all around), much wider than all the rest."""
    (low, high), (rest_low, rest_high) = _box([body]), _box(rest)
    width, rest_width = float(np.linalg.norm(high - low)), float(np.linalg.norm(rest_high - rest_low))
    flat = float((high - low).min()) < _FLAT * width
    around = bool((low <= rest_low).all() and (high >= rest_high).all())
    simple = len(body.triangles) < sum(len(other.triangles) for other in rest)
    return rest_width > 0 and width > _BACKDROP * rest_width and (flat or (around and simple))


def group_weights(objects: Sequence[bpy.types.Object]) -> list[dict[str, np.ndarray]]:
    """Return, per mesh object of the scene, {group name: weights [V]}, float64, 0 where unassigned.

    The objects must have no modifiers.
    """
    named = [[group.name for group in obj.vertex_groups] for obj in objects]
    trees: dict[tuple[str, ...], bpy.types.NodeTree] = {}
    for obj, names in zip(objects, named, strict=True):
        if names:
            key = tuple(names)
            if key not in trees:
                trees[key] = _converter(names)
            obj.modifiers.new("weights", "NODES").node_group = trees[key]
    depsgraph = bpy.context.evaluated_depsgraph_get()
    found = [_read(obj.evaluated_get(depsgraph), names) for obj, names in zip(objects, named, strict=True)]
    for obj, names in zip(objects, named, strict=True):
        if names:
            obj.modifiers.clear()
    for tree in trees.values():
        bpy.data.node_groups.remove(tree)
    return found


def _converter(names: Sequence[str]) -> bpy.types.NodeTree:
    """Nodes that store every vertex group as a plain attribute of the points."""
    tree = bpy.data.node_groups.new("tg4mm weights", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    geometry = tree.nodes.new("NodeGroupInput").outputs[0]
    for i, name in enumerate(names):
        source, store = (
            tree.nodes.new(f"GeometryNode{kind}") for kind in ("InputNamedAttribute", "StoreNamedAttribute")
        )
        source.data_type = store.data_type = "FLOAT"
        store.domain = "POINT"
        source.inputs["Name"].default_value = name
        store.inputs["Name"].default_value = _TARGET.format(i)
        tree.links.new(geometry, store.inputs["Geometry"])
        value = next(socket for socket in source.outputs if socket.name == "Attribute" and socket.enabled)
        tree.links.new(value, next(s for s in store.inputs if s.name == "Value" and s.enabled))
        geometry = store.outputs["Geometry"]
    tree.links.new(geometry, tree.nodes.new("NodeGroupOutput").inputs[0])
    return tree


def _read(obj: bpy.types.Object, names: Sequence[str]) -> dict[str, np.ndarray]:
    mesh, found = obj.data, {}
    for i, name in enumerate(names):
        weights = np.empty(len(mesh.vertices), np.float32)
        mesh.attributes[_TARGET.format(i)].data.foreach_get("value", weights)
        found[name] = weights.astype(np.float64)
    return found
