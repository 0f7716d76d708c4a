"""Runs inside Blender: answers questions that another process leaves in a folder, a few times a second.

Started by `blender --python answering.py -- FOLDER`. A question is FOLDER/ask.json, {"id", "name", "with"}; the
answer is FOLDER/answer.json, {"id", "value"} or {"id", "error"}. The names are those of the functions marked
`@answer`. They read; only those in SETTING set up or measure a scene or a view. What a test is about is done with the
mouse.
"""

import json
import math
import os
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np

INTERVAL = 0.05  # s
FOLDER = Path(sys.argv[sys.argv.index("--") + 1])
SETTING = {"calling", "clear", "draw_as", "drawing", "put_away", "stepping", "sway", "view"}
ANSWERS: dict[str, Callable[..., Any]] = {}


def answer(function):
    ANSWERS[function.__name__] = function
    return function


@answer
def value(of):
    """What an expression of `bpy` is."""
    return eval(of)


@answer
def areas():
    """Every area with its regions: pixels from the window's upper left corner."""
    window = _window()
    return [
        {"type": area.type, "regions": {region.type: _box(region, window.height) for region in area.regions}}
        for area in window.screen.areas
    ]


def _box(region, height):
    """Left, top, width, height."""
    return [region.x, height - region.y - region.height, region.width, region.height]


@answer
def tab():
    """The tab that the sidebar of the 3D view shows; empty where there is no sidebar."""
    area = _view()
    if not area.spaces.active.show_region_ui:
        return ""
    return next(region for region in area.regions if region.type == "UI").active_panel_category


@answer
def frame():
    scene = bpy.context.scene
    playing = any(window.screen.is_animation_playing for window in bpy.context.window_manager.windows)
    return {
        "current": scene.frame_current,
        "first": scene.frame_start,
        "last": scene.frame_end,
        "fps": scene.render.fps / scene.render.fps_base,
        "playing": playing,
    }


@answer
def inputs():
    """Value of every input of the active object's splat modifier, menus as the names of their items."""
    modifier = _modifier()
    values = {}
    for item in modifier.node_group.interface.items_tree:
        if item.item_type == "SOCKET" and item.in_out == "INPUT" and item.socket_type != "NodeSocketGeometry":
            values[item.name] = getattr(modifier.properties.inputs, item.identifier).value
    return values


@answer
def paths():
    """Data path, from its object, of every input of the active object's splat modifier."""
    modifier = _modifier()
    return {
        item.name: f'modifiers["{modifier.name}"].properties.inputs.{item.identifier}.value'
        for item in modifier.node_group.interface.items_tree
        if item.item_type == "SOCKET" and item.in_out == "INPUT"
    }


@answer
def places(file):
    """Write float32 [N, 3], where the instances of the active object are drawn, as .npy; returns N."""
    obj = bpy.context.view_layer.objects.active
    geometry = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    cloud = geometry.instances_pointcloud()
    flat = np.empty(len(cloud.points) * 16, dtype=np.float32)
    cloud.attributes["instance_transform"].data.foreach_get("value", flat)
    np.save(FOLDER / file, flat.reshape(-1, 4, 4)[:, 3, :3])
    return len(cloud.points)


@answer
def chosen_file():
    """The path that the file browser is at; empty where none is open."""
    for area in _window().screen.areas:
        if area.type == "FILE_BROWSER" and area.spaces.active.params is not None:
            params = area.spaces.active.params
            return os.path.join(os.fsdecode(params.directory), params.filename)
    return ""


@answer
def view(look_from, at, distance):
    """Turn the 3D view: `look_from` a direction, `at` a point, `distance` in scene units."""
    import mathutils

    region = _view().spaces.active.region_3d
    region.view_rotation = mathutils.Vector(look_from).to_track_quat("Z", "Y")
    region.view_location, region.view_distance, region.view_perspective = at, distance, "PERSP"


@answer
def drawing(frames):
    """Processor time of drawing the window, all threads, ms: of each frame while the view turns by 1° a frame."""
    import mathutils

    region = _view().spaces.active.region_3d
    turn = mathutils.Quaternion((0, 0, 1), math.radians(1))
    took = []
    for _ in range(frames):
        region.view_rotation = turn @ region.view_rotation
        took.append(_took(lambda: bpy.ops.wm.redraw_timer(type="DRAW_WIN_SWAP", iterations=1)))
    return took


@answer
def stepping(frames):
    """Processor time of evaluating each of the next frames, all threads, ms; nothing is drawn."""
    return [_took(lambda: bpy.ops.wm.redraw_timer(type="ANIM_STEP", iterations=1)) for _ in range(frames)]


@answer
def calling(operator, frames):
    """Processor time of an operator in each of the next frames, all threads, ms."""
    module, _, name = operator.partition(".")
    took = []
    for _ in range(frames):
        bpy.context.scene.frame_set(bpy.context.scene.frame_current + 1)
        took.append(_took(getattr(getattr(bpy.ops, module), name)))
    return took


@answer
def draw_as(mode):
    """Choose the active object's draw mode."""
    tree = _modifier().node_group
    socket = next(item for item in tree.interface.items_tree if item.name == "Draw As")
    getattr(_modifier().properties.inputs, socket.identifier).value = mode
    bpy.context.view_layer.objects.active.update_tag()


@answer
def put_away():
    """Show a text editor in place of the 3D view, so that nothing of the scene is drawn."""
    _view().type = "TEXT_EDITOR"


@answer
def sway(frequency):
    """Let the active mesh sway by a shape key with a driver: motion as other add-ons can play it."""
    obj = bpy.context.view_layer.objects.active
    obj.shape_key_add(name="Rest")
    moved, mesh = obj.shape_key_add(name="Mode"), obj.data
    places = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", places)
    places[2::3] += 0.02 * np.cos(places[::3])
    moved.data.foreach_set("co", places)
    moved.slider_min = -1.0
    fps = bpy.context.scene.render.fps
    moved.driver_add("value").driver.expression = f"sin({2 * math.pi * frequency / fps} * frame)"


def _took(call):
    start = time.process_time()
    call()
    return (time.process_time() - start) * 1e3


@answer
def clear():
    """Remove all objects: the cube, the lamp and the camera that Blender starts with."""
    bpy.data.batch_remove(list(bpy.data.objects))


def _window():
    return bpy.context.window_manager.windows[0]


def _view():
    return max(
        (area for area in _window().screen.areas if area.type == "VIEW_3D"),
        key=lambda area: area.width * area.height,
    )


def _modifier():
    obj = bpy.context.view_layer.objects.active
    return next(modifier for modifier in obj.modifiers if modifier.type == "NODES")


def _answer_what_is_asked():
    ask = FOLDER / "ask.json"
    if not ask.exists():
        return INTERVAL
    question = json.loads(ask.read_text(encoding="utf-8"))
    ask.unlink()
    reply: dict[str, Any] = {"id": question["id"]}
    try:
        with bpy.context.temp_override(window=_window()):
            reply["value"] = ANSWERS[question["name"]](**question["with"])
            if question["name"] in SETTING:  # nothing else tells Blender that the window is out of date
                for area in _window().screen.areas:
                    area.tag_redraw()
    except Exception:  # whatever it was, the other side raises it
        reply["error"] = traceback.format_exc()
    partial = FOLDER / "answer.partial"
    partial.write_text(json.dumps(reply), encoding="utf-8")
    os.replace(partial, FOLDER / "answer.json")
    return INTERVAL


bpy.context.preferences.view.show_splash = False
# In a window of its own it would lie across the screen's edge, as no window manager is there to place it.
bpy.context.preferences.view.filebrowser_display_type = "SCREEN"
bpy.app.timers.register(_answer_what_is_asked, first_interval=1.0, persistent=True)
