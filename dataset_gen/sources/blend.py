"""Opens a user's .blend file as a stage: what it shows at one frame, at rest."""

import math
import os
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np

from ..cameras import SceneCamera, scene_cameras
from ..compat import is_5
from ..errors import GenerateError
from . import bodies_file
from .assemble import LoadedScene, Origin, assemble
from .copies import own_world
from .gather import gather
from .images import find_images, list_names

_NEUTRAL_VIEWS = ("Standard", "Raw", "Default")  # "Default": sRGB of files before 2.80
_UNITS = {  # Blender's names of units → metres
    "KILOMETERS": ("km", 1e3),
    "METERS": ("m", 1.0),
    "CENTIMETERS": ("cm", 1e-2),
    "MILLIMETERS": ("mm", 1e-3),
    "MICROMETERS": ("µm", 1e-6),
    "MILES": ("mi", 1609.344),
    "FEET": ("ft", 0.3048),
    "INCHES": ("in", 0.0254),
    "THOU": ("thou", 2.54e-5),
}

# Nodes of a compositor that change nothing.
_PASSING = ("RLayers", "Composite", "Viewer", "OutputFile")
_PLAIN_NODES = (
    *(f"CompositorNode{kind}" for kind in _PASSING), "NodeGroupOutput", "NodeFrame", "NodeReroute",
)  # fmt: skip


def open_blend(path: Path, *, frame: int | None = None, scene: str | None = None) -> LoadedScene:
    """Takes over this process's Blender session with a .blend file.

    Every surface that would render becomes a plain mesh in world space, as evaluated with its modifiers at
    `frame` (the file's current one by default) of `scene` (the file's active one). Scripts in the file never
    run. Raises GenerateError, one line, if the file cannot be used.
    """
    _open(path.absolute())
    old = _choose_scene(path, scene)
    warnings = _lost_libraries() + _silent_drivers() + find_images(path.absolute().parent)
    others = [other.name for other in bpy.data.scenes if other != old]
    if others and scene is None:
        warnings.append(f"scene {old.name} is used; the file also holds {list_names(others)}")
    if frame is None:
        old.frame_set(old.frame_current, subframe=old.frame_subframe)
    else:
        old.frame_set(frame)
    warnings += left_out(old)
    names, cameras = file_cameras(old, warnings)
    exposure = 2.0**old.view_settings.exposure * old.cycles.film_exposure
    if old.view_settings.view_transform not in _NEUTRAL_VIEWS:
        warnings.append(
            f"view transform {old.view_settings.view_transform} is replaced by Standard: colours will differ"
        )
    return assemble(
        gather(old), old, Origin(path, _unit_scale(old), own_unit(old), cameras, names, exposure), _light,
        warnings,
    )  # fmt: skip


def _open(path: Path) -> None:
    running = (bpy.app.version[0], bpy.app.version[1])
    bodies_file.check(path, running)
    try:
        bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False, use_scripts=False)
    except RuntimeError as error:
        reason = " ".join(str(error).removeprefix("Error: ").split())
        raise GenerateError(f"{path} cannot be opened: {reason}") from None
    if not bpy.data.filepath or not os.path.samefile(bpy.data.filepath, path):
        raise GenerateError(f"{path} cannot be opened: it is truncated, damaged or not a .blend file")
    bodies_file.check_version(path, (bpy.data.version[0], bpy.data.version[1]), running)


def _choose_scene(path: Path, name: str | None) -> bpy.types.Scene:
    if name is not None:
        if name not in bpy.data.scenes:
            known = list_names(scene.name for scene in bpy.data.scenes)
            raise GenerateError(f"{path} holds no scene {name!r}: there is {known}")
        bpy.context.window.scene = bpy.data.scenes[name]
    return bpy.context.scene


def _lost_libraries() -> list[str]:
    lost = [
        library.filepath
        for library in bpy.data.libraries
        if not library.packed_file and not os.path.isfile(bpy.path.abspath(library.filepath))
    ]
    return [f"linked library {path} is missing: what it holds is left out" for path in lost]


def _silent_drivers() -> list[str]:
    """Drivers that are Python code beyond arithmetic do not run: what they drive stays as it was saved."""
    silent = {
        block.name
        for blocks in (bpy.data.objects, bpy.data.meshes, bpy.data.materials, bpy.data.shape_keys)
        for block in blocks
        if block.animation_data
        for curve in block.animation_data.drivers
        if curve.driver.type == "SCRIPTED" and not curve.driver.is_simple_expression
    }
    return [f"scripted drivers of {list_names(silent)} do not run: values are as saved"] if silent else []


def file_cameras(
    scene: bpy.types.Scene, warnings: list[str]
) -> tuple[tuple[str, ...], tuple[SceneCamera, ...]]:
    """Names and views of the perspective cameras of the scene, the active one first."""
    objects = sorted(
        (obj for obj in scene.objects if obj.type == "CAMERA"),
        key=lambda obj: (obj != scene.camera, obj.name),
    )
    other = {obj.name for obj in objects if obj.data.type != "PERSP"}
    if other:
        warnings.append(f"cameras {list_names(other)} are not perspective: left out")
    names, poses, angles, shifts = [], [], [], []
    for obj in objects:
        pose = np.array(obj.matrix_world, np.float64)
        if obj.name in other or abs(np.linalg.det(pose[:3, :3])) < 1e-12:
            continue
        angle, shift = _lens(obj, scene)
        names.append(obj.name)
        poses.append(pose)
        angles.append(angle)
        shifts.append(shift)
    return tuple(names), scene_cameras(poses, angles, shifts)


def _lens(obj: bpy.types.Object, scene: bpy.types.Scene) -> tuple[float, tuple[float, float]]:
    """Horizontal field of view (radians) in the file's own picture, and the principal point off its centre."""
    corners = np.array([tuple(corner) for corner in obj.data.view_frame(scene=scene)])
    low, high, depth = corners[:, :2].min(0), corners[:, :2].max(0), -corners[0, 2]
    width = high[0] - low[0]
    centre = 0.5 * (low + high) / width
    return 2.0 * math.atan(0.5 * width / depth), (float(-centre[0]), float(centre[1]))


def _unit_scale(scene: bpy.types.Scene) -> float | None:
    units = scene.unit_settings
    return float(units.scale_length) if units.system in ("METRIC", "IMPERIAL") else None


def own_unit(scene: bpy.types.Scene) -> tuple[str, float]:
    """The unit in which the file shows lengths, and how many of it a scene unit is."""
    if (scale := _unit_scale(scene)) is None:
        return "scene units", 1.0
    default = "METERS" if scene.unit_settings.system == "METRIC" else "FEET"
    name, metres = _UNITS.get(
        scene.unit_settings.length_unit, _UNITS[default]
    )  # "ADAPTIVE" is not one of them
    return name, scale / metres


def _light(scene: bpy.types.Scene, old: bpy.types.Scene, lit: bool, warnings: list[str]) -> None:
    scene.world = own_world(old, lit, warnings)


def left_out(scene: bpy.types.Scene) -> list[str]:
    """One line each for what stands between the scene and the pictures that its own settings would give."""
    return [f"left out, {line}" for line in (*_after_render(scene), *_of_render(scene), *_of_objects(scene))]


def _after_render(scene: bpy.types.Scene) -> Iterator[str]:
    render, view = scene.render, scene.view_settings
    tree = (
        scene.compositing_node_group if is_5() else (scene.node_tree if scene.use_nodes else None)
    )  # 4.5 keeps a tree that is switched off
    if render.use_compositing and tree is not None:
        nodes = {node.name for node in tree.nodes if node.bl_idname not in _PLAIN_NODES and not node.mute}
        if nodes:
            yield f"compositor: {list_names(nodes)}"
    if render.use_sequencer and scene.sequence_editor and len(scene.sequence_editor.strips):
        yield f"video sequencer: {list_names(strip.name for strip in scene.sequence_editor.strips)}"
    changes = {
        f"look {view.look}": view.look != "None",
        f"gamma {view.gamma:g}": view.gamma != 1.0,
        "curves": view.use_curve_mapping,
    }
    if any(changes.values()):
        yield f"colour management: {', '.join(name for name, there in changes.items() if there)}"


def _of_render(scene: bpy.types.Scene) -> Iterator[str]:
    render = scene.render
    if render.use_freestyle and any(layer.use_freestyle for layer in scene.view_layers):
        yield "Freestyle lines"
    if render.use_motion_blur:
        yield "motion blur"
    if render.use_multiview:
        yield "stereo views"
    if render.use_border:
        yield "render region: pictures are whole"
    if render.use_simplify:
        yield "Simplify: geometry is at its full detail"


def _of_objects(scene: bpy.types.Scene) -> Iterator[str]:
    blurred = {obj.name for obj in scene.objects if obj.type == "CAMERA" and obj.data.dof.use_dof}
    if blurred:
        yield f"depth of field of cameras: {list_names(blurred)}"
    linked = {
        obj.name
        for obj in scene.objects
        if obj.light_linking.receiver_collection or obj.light_linking.blocker_collection
    }
    if linked:
        yield f"light linking of: {list_names(linked)}"
    moving = {obj.name for obj in scene.objects if obj.animation_data and obj.animation_data.action}
    if moving:
        yield f"animation, at frame {scene.frame_current} all stands still: {list_names(moving)}"
