"""The live preview: temporary modifiers show the motion at any gain."""

import cmath
import math
from typing import Any

import bpy
import numpy as np
from bpy.app.handlers import persistent

from dataset_gen.errors import GenerateError
from dataset_gen.vibration import Motion, Vibration
from dataset_gen.vibration.motion import Basis

from .. import compat
from ..nodes.graph import Graph
from . import kinds, objects

MARK = "tg4mm_preview"  # custom property of our data-blocks
MODIFIER = "TG4MM Preview"
_DELAY_S = 0.05  # while a slider is dragged, one refresh for several steps
_problem = ""


def active() -> bool:
    """Return whether a preview is shown."""
    return any(MARK in tree for tree in bpy.data.node_groups)


def problem() -> str:
    """Return why the last refresh removed the preview, or an empty string."""
    return _problem


def start(context: Any) -> int:
    """Show the motion that the scene's settings describe and return the number of moving objects.

    Raises GenerateError, one line, if they describe none; then there is no preview.
    """
    global _problem
    _problem = ""
    stop()
    scene, settings = context.scene, context.scene.tg4mm_generate
    depsgraph = context.evaluated_depsgraph_get()
    shown = objects.previewed(context.view_layer)
    group = settings.group if settings.kind == "group" else ""
    made = [
        (obj, body)
        for obj, body in zip(shown, objects.bodies(shown, depsgraph, group), strict=True)
        if len(body.vertices)
    ]
    bodies = [body for _, body in made]
    chosen = objects.moving(settings)
    parts = [glob for glob in objects.parts([o for o in chosen if o in shown], depsgraph) if "/" not in glob]
    if chosen and not parts and settings.source == "PANEL":
        raise GenerateError("no moving object is a mesh visible here and in renders")
    if not bodies:
        raise GenerateError("the scene shows no mesh")
    motion = kinds.motion(settings, kinds.description(settings, parts), bodies, scene)
    tree = build_tree(MODIFIER, motion, settings.gain, scene.frame_start)
    tree[MARK] = 1
    moved = 0
    for number, (obj, _) in enumerate(made):
        if motion.basis[number].any():
            _attach(obj, objects.to_local(obj, depsgraph, motion.basis[number]), tree)
            moved += 1
    return moved


def stop() -> None:
    """Remove the preview completely."""
    trees = [tree for tree in bpy.data.node_groups if MARK in tree]
    helpers = [obj for obj in bpy.data.objects if MARK in obj]
    meshes = [mesh for mesh in bpy.data.meshes if MARK in mesh]
    if not (trees or helpers or meshes):
        return
    for obj in bpy.data.objects:
        if obj.type == "MESH":
            for modifier in [m for m in obj.modifiers if m.type == "NODES" and m.node_group in trees]:
                obj.modifiers.remove(modifier)
    bpy.data.batch_remove([*helpers, *meshes, *trees])


def set_gain(gain: float) -> None:
    """Show the motion at another gain."""
    for tree in bpy.data.node_groups:
        if MARK in tree:
            tree.nodes[GAIN].outputs[0].default_value = gain


def refresh(context: Any = None) -> None:
    """Recompute the preview if there is one; on failure remove it and keep the reason in `problem`."""
    global _problem
    context = context or bpy.context
    if not active() or context.mode != "OBJECT":
        return
    try:
        start(context)
    except (GenerateError, ValueError) as error:
        _problem = str(error)


def refresh_soon() -> None:
    """Schedule `refresh` by a timer, because dragging a slider changes settings many times a second."""
    if active() and not bpy.app.background and not bpy.app.timers.is_registered(_refresh_once):
        bpy.app.timers.register(_refresh_once, first_interval=_DELAY_S)


def _refresh_once() -> None:
    refresh()


def _attach(obj: Any, basis: np.ndarray, tree: Any) -> None:
    """Move an object by basis shapes [G, V, 3] in its own axes."""
    mesh = bpy.data.meshes.new(MODIFIER)
    mesh[MARK] = 1
    mesh.vertices.add(basis.shape[1])
    for number, shape in enumerate(basis):
        data = mesh.attributes.new(attribute(number), "FLOAT_VECTOR", "POINT").data
        data.foreach_set("vector", shape.astype(np.float32).ravel())
    helper = bpy.data.objects.new(MODIFIER, mesh)
    helper[MARK] = 1
    modifier = obj.modifiers.new(MODIFIER, "NODES")
    modifier.node_group = tree
    modifier.show_render = False
    modifier.show_expanded = False
    compat.set_input(modifier, HELPER, helper)


@persistent
def _before_saving(*_: Any) -> None:
    stop()


@persistent
def _after_loading(*_: Any) -> None:
    stop()  # of a file that was saved behind our back, by autosave


@persistent
def _after_undo(*_: Any) -> None:
    refresh_soon()


_HANDLERS = (
    ("save_pre", _before_saving),
    ("load_post", _after_loading),
    ("undo_post", _after_undo),
    ("redo_post", _after_undo),
)


def register() -> None:
    for where, handler in _HANDLERS:
        getattr(bpy.app.handlers, where).append(handler)


def unregister() -> None:
    for where, handler in reversed(_HANDLERS):
        getattr(bpy.app.handlers, where).remove(handler)
    if bpy.app.timers.is_registered(_refresh_once):
        bpy.app.timers.unregister(_refresh_once)
    stop()


HELPER = "Displacements"  # the modifier's input
GAIN = "tg4mm gain"  # the node that holds it


def attribute(number: int) -> str:
    """Return the name of the helper's vector attribute for basis shape `number`, in local axes."""
    return f"basis_{number}"


def build_tree(name: str, motion: Motion, gain: float, first_frame: int) -> Any:
    """Build a node tree for the basis shapes of a motion."""
    graph = Graph(bpy.data.node_groups.new(name, "GeometryNodeTree"))
    graph.tree.is_modifier = True
    graph.interface("Geometry", "Geometry")
    graph.interface(HELPER, "Object")
    graph.result("Geometry", "Geometry")
    inputs = graph.inputs()
    helper = graph.call("GeometryNodeObjectInfo", {"Object": inputs[HELPER]}, "Geometry")
    index = graph.node("GeometryNodeInputIndex").outputs[0]
    frame = graph.node("GeometryNodeInputSceneTime").outputs["Frame"]
    t = graph.math("SUBTRACT", frame, float(first_frame))
    total: Any = None
    for number, basis in enumerate(motion.bases):
        shape = graph.attribute(attribute(number), "FLOAT_VECTOR")
        taken = {"Geometry": helper, "Value": shape, "Index": index}
        vector = graph.call("GeometryNodeSampleIndex", taken, data_type="FLOAT_VECTOR", domain="POINT")
        part = graph.scaled(vector, _gain(graph, motion, basis, t))
        total = part if total is None else graph.vector("ADD", total, part)
    node = graph.node("ShaderNodeValue", name=GAIN)
    node.outputs[0].default_value = gain
    offset = graph.scaled(total, node.outputs[0])
    moved = graph.call("GeometryNodeSetPosition", {"Geometry": inputs["Geometry"], "Offset": offset})
    graph.finish(Geometry=moved)
    return graph.tree


def _gain(graph: Graph, motion: Motion, basis: Basis, t: Any) -> Any:
    law, turn = motion.laws[basis.mode], cmath.phase(basis.turn)
    if not isinstance(law, Vibration):  # a ramp, i t / fps
        slope = 1j * basis.turn / motion.fps
        return graph.math("MULTIPLY", t, slope.imag if basis.quadrature else slope.real)
    # Whole turns are taken off before the angle: the tree computes in float32.
    turns = graph.math("FRACT", graph.math("MULTIPLY", t, law.frequency_hz / motion.fps))
    angle = graph.math("MULTIPLY_ADD", turns, 2.0 * math.pi, turn)
    wave = graph.math("SINE" if basis.quadrature else "COSINE", angle)
    if law.decay_s is None:
        return wave
    fall = graph.math("EXPONENT", graph.math("MULTIPLY", t, -1.0 / (motion.fps * law.decay_s)))
    return graph.math("MULTIPLY", wave, fall)
