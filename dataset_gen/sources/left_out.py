"""What a .blend file does to its pictures that a set does not have: named, so that nothing is dropped in silence."""

from __future__ import annotations

from collections.abc import Iterator

import bpy

from ..compat import is_5
from .names import list_names

# Nodes of a compositor that change nothing.
_PASSING = ("RLayers", "Composite", "Viewer", "OutputFile")
_PLAIN_NODES = (
    *(f"CompositorNode{kind}" for kind in _PASSING),
    "NodeGroupOutput",
    "NodeFrame",
    "NodeReroute",
)


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
