"""The tree of the modifier: points → where Apply Transform found them → motion or sequence → colour → shapes → back."""

from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import bpy

from .. import compat, names
from .applied import Applied, applied, at_rest, build_applied, growth, parts, put_back
from .clock import whole_band
from .colours import C0, build_colour_map, build_encoded, build_harmonics, camera_place
from .graph import Graph, Made
from .motion import MotionSockets, build_motion, build_sequence, use_motion
from .shapes import DRAW_MODES, USUAL, Materials, available, build_shapes, is_drawn

MANY_ARROWS = 2000  # beyond these an arrow stands for several Gaussians

# name, default, least, most, description
_MOTION = (
    # The limits are the slider's: any number can be typed.
    (names.ALPHA, 0.0, -1.0, 100.0, "0: as recorded; 50: 51 times as large; −1: frozen"),
    (names.LOW, 0.0, 0.0, 1e6, "Lowest frequency that is magnified, Hz"),
    (names.HIGH, 1e6, 0.0, 1e6, "Highest frequency that is magnified, Hz"),
)
_TIME = ((names.FIRST, 1.0, -1e6, 1e6, "Frame that shows timestep 0"), (names.SPEED, 1.0, -1e3, 1e3, ""))
_SPEEDS = ("Files per frame", "1: as fast as it was recorded; 0.1: ten times slower, for slow motion")
_LOOK = (
    (names.SIZE, 1.0, 0.0, 10.0, "Factor on the size of every Gaussian"),
    (
        names.RADIUS,
        1.6,
        0.01,
        6.0,
        "Where an ellipsoid or a dot ends, in standard deviations of its Gaussian",
    ),
    (names.MIN_OPACITY, 0.1, 0.0, 1.0, "Gaussians less opaque than this are drawn as splats only"),
    (names.MIN_SPLAT_OPACITY, 1 / 255, 0.0, 1.0, "Gaussians less opaque than this are not drawn as splats"),
)


@dataclass(frozen=True)
class Content:
    """The content of a tree: modes of motion, a collection with one object per frame, or neither."""

    count: int  # Gaussians
    sh_degree: int = 0
    freqs_hz: Sequence[float] = ()
    fps: float = 0.0  # Hz, of the modes
    amplitude: float = 0.0  # scene units: the largest that the colours need to show
    frames: Any = None  # the collection
    n_frames: int = 0


def build_player(name: str, content: Content, materials: Materials, made: Made) -> Any:
    """Build the modifier's node group; every group created is recorded in `made`."""
    graph = Graph(made.keep(bpy.data.node_groups.new(name, "GeometryNodeTree")))
    graph.tree.is_modifier = True
    graph.interface("Geometry", "Geometry")
    graph.result("Geometry", "Geometry")
    _declare(graph, content)
    inputs = graph.inputs()
    draw = _as_one_mesh(
        graph,
        graph.menu(inputs[names.DRAW], _numbered(DRAW_MODES, available(len(content.freqs_hz) > 0))),
        inputs,
    )
    by = (
        graph.menu(inputs[names.COLOUR_BY], _numbered(names.COLOUR_ITEMS, names.COLOUR_ITEMS))
        if len(content.freqs_hz)
        else 0
    )
    _preset_menus(graph)
    # What Join put together is played part by part. A sequence has its points elsewhere.
    count, number = (1, 0) if content.frames is not None else parts(graph, inputs["Geometry"])
    turn, before, end = graph.repeat(count)
    mine = {"Geometry": inputs["Geometry"], "Selection": graph.compare("EQUAL", number, turn, "INT")}
    part = graph.call("GeometryNodeSeparateGeometry", mine, domain="POINT")
    several = graph.compare("GREATER_THAN", count, 1, "INT")
    group = made.keep(build_applied(name, names.modes_number(content.freqs_hz, content.fps)))
    moved, points = applied(graph, group, graph.choose("GEOMETRY", several, inputs["Geometry"], part))
    drawn = _played(graph, points, inputs, content, (draw, by), moved, materials, (name, made))
    graph.finish(Geometry=graph.repeated(end, before, drawn))
    return graph.tree


def _played(
    graph: Graph,
    points: Any,
    inputs: Any,
    content: Content,
    chosen: tuple[Any, Any],
    moved: Applied,
    materials: Materials,
    kept: tuple[str, Made],
) -> Any:
    (draw, by), (name, made), motion = chosen, kept, None
    if content.frames is not None:
        group = made.keep(build_sequence(name, content.frames, content.n_frames))
        points = graph.group(
            group, **{socket: inputs[socket] for socket in (names.FIRST, names.SPEED, names.LOOP)}
        )[0]
    else:
        place = at_rest(graph, moved, graph.node("GeometryNodeInputPosition").outputs[0])
        rest = graph.call("GeometryNodeSetPosition", {"Geometry": points, "Position": place})
        points = graph.choose("GEOMETRY", moved.changed, points, rest)
    if len(content.freqs_hz):
        motion = use_motion(graph, build_motion(name, content.freqs_hz, content.fps, made), inputs)
        points = _moved(graph, points, motion, draw)
    points = _coloured(graph, points, inputs, content, by, motion, moved, kept)
    encoded = made.keep(build_encoded(name))
    for_screen = graph.group(encoded, Colour=graph.attribute(names.COLOUR, "FLOAT_COLOR"))[0]
    as_trained = graph.store(points, names.COLOUR, "FLOAT_COLOR", for_screen)
    points = graph.choose("GEOMETRY", inputs[names.BLEND], points, as_trained)
    for prefix in (names.MODE_PREFIX, names.REFERENCE):
        # Instances would carry a copy of each attribute of their point.
        points = graph.without(points, f"{prefix}*")
    plain, native = graph.without(points, f"{names.NATIVE_PREFIX}*"), None
    if compat.native_splats():
        native = is_drawn(graph, draw, lambda mode: mode.native)
        analysed = graph.compare("GREATER_THAN", by, 0, "INT")
        painted = graph.either(analysed, inputs[names.BLEND])
        own = graph.choose("GEOMETRY", painted, points, _native_colours(graph, points, encoded))
        plain = graph.choose("GEOMETRY", native, plain, own)
    shapes = graph.node("GeometryNodeGroup", node_tree=made.keep(build_shapes(name, materials)))
    values = {"Points": plain, names.DRAW: draw, "Growth": growth(graph, moved)}
    declared = {socket.name for socket in inputs}
    for socket in shapes.inputs:
        if socket.name in values or socket.name in declared:
            graph.put(values.get(socket.name, inputs.get(socket.name)), socket)
    return put_back(graph, moved, shapes.outputs[0], native)


def _native_colours(graph: Graph, points: Any, encoded: Any) -> Any:
    """Points whose colours, once for all directions, are what Blender's own splats show."""
    shown = graph.group(encoded, Colour=graph.attribute(names.COLOUR, "FLOAT_COLOR"))[0]
    first = graph.scaled(graph.vector("SUBTRACT", shown, (0.5, 0.5, 0.5)), 1 / C0)
    opacity = graph.math("MAXIMUM", graph.attribute(names.OPACITY, "FLOAT"), 0.0)
    channels = dict(zip(("Red", "Green", "Blue"), graph.split(first), strict=True))
    base = graph.call("FunctionNodeCombineColor", {**channels, "Alpha": opacity})
    points = graph.without(points, f"{names.NATIVE_PREFIX}sh_*")
    return graph.store(points, names.NATIVE_BASE, "FLOAT_COLOR", base)


def _declare(graph: Graph, content: Content) -> None:
    """Declare the modifier's inputs in display order."""
    moves = len(content.freqs_hz) > 0
    rows = (*(_MOTION if moves else ()), *(_TIME if moves or content.n_frames else ()), *_LOOK)
    for name, default, least, most, text in rows:
        if name == names.SPEED:
            text = _SPEEDS[moves]
        if name == names.HIGH:
            default = whole_band(content.freqs_hz, content.fps)[1]
        graph.interface(name, "Float", default, min_value=least, max_value=most, description=text)
    if content.n_frames:
        graph.interface(names.LOOP, "Bool", False, description="Start again after the last file")
    graph.interface(names.DRAW, "Menu", description="Shape drawn for every Gaussian")
    if content.sh_degree:
        text = "Colours as seen from the scene's camera instead of the mean over all directions"
        graph.interface(names.VIEW_COLOUR, "Bool", False, description=text)
    text = "Display colours, so that splats blend as in training; needs the view transform Raw"
    graph.interface(names.BLEND, "Bool", False, description=text)
    text = "Output one mesh, whose colours Solid view shows (Colour: Attribute); for small sets"
    graph.interface(names.SOLID_COLOUR, "Bool", False, description=text)
    if moves:
        _declare_analysis(graph, content)


def _declare_analysis(graph: Graph, content: Content) -> None:
    text = "The file's colours, or the amplitude or the phase of the motion in the band"
    graph.interface(names.COLOUR_BY, "Menu", description=text)
    text = "Amplitude shown in the last colour, scene units"
    graph.interface(names.COLOUR_RANGE, "Float", content.amplitude or 1.0, min_value=0.0, description=text)
    text = "Ratio of an arrow's length to the magnified displacement"
    graph.interface(names.ARROW_LENGTH, "Float", 1.0, min_value=0.0, description=text)
    every = -(-content.count // MANY_ARROWS)
    text = "Draw an arrow for every n-th Gaussian"
    graph.interface(names.ARROW_EVERY, "Int", every, min_value=1, description=text)
    panel = graph.tree.interface.new_panel("Frequencies")
    for name in names.toggles(content.freqs_hz):
        graph.interface(name, "Bool", True, description="Play this mode")
        graph.tree.interface.move_to_parent(graph.tree.interface.items_tree[name], panel, 999)


def _as_one_mesh(graph: Graph, draw: Any, inputs: Any) -> Any:
    """Return the shapes to draw: one mesh has no transparency, so it shows splats as ellipsoids."""
    as_mesh = graph.both(is_drawn(graph, draw, lambda mode: mode.soft), inputs[names.SOLID_COLOUR])
    return graph.choose("INT", as_mesh, draw, list(DRAW_MODES).index(USUAL))


def _numbered(items: Iterable[str], offered: Container[str]) -> dict[str, int]:
    """Name → number of the items of a menu that are offered."""
    return {name: number for number, name in enumerate(items) if name in offered}


def _preset_menus(graph: Graph) -> None:
    """Set menu defaults last, because a menu input gets its items from its links."""
    for name, item in ((names.DRAW, USUAL), (names.COLOUR_BY, names.FILE_COLOUR)):
        if name in graph.tree.interface.items_tree:
            graph.tree.interface.items_tree[name].default_value = item


def _moved(graph: Graph, points: Any, motion: MotionSockets, draw: Any) -> Any:
    still, round_ = (
        is_drawn(graph, draw, lambda mode: mode.still),
        is_drawn(graph, draw, lambda mode: not mode.turns),
    )
    noted = graph.store(points, names.DISPLACEMENT, "FLOAT_VECTOR", motion.offset)
    moved = graph.call("GeometryNodeSetPosition", {"Geometry": points, "Offset": motion.offset})
    turned = graph.store(moved, names.ROTATION, "QUATERNION", _rotation(graph, motion.turn))
    return graph.choose("GEOMETRY", still, graph.choose("GEOMETRY", round_, turned, moved), noted)


def _rotation(graph: Graph, turn: Any) -> Any:
    """exp(turn)·q: the rest rotation, then the rotation vector about the object's axes."""
    # Axis Angle normalises its axis.
    angle = {"Axis": turn, "Angle": graph.length(turn)}
    turned = graph.call("FunctionNodeAxisAngleToRotation", angle)
    rest = graph.attribute(names.ROTATION, "QUATERNION")
    inputs = {"Rotation": rest, "Rotate By": turned}
    return graph.call("FunctionNodeRotateRotation", inputs, rotation_space="GLOBAL")


def _coloured(
    graph: Graph,
    points: Any,
    inputs: Any,
    content: Content,
    by: Any,
    motion: MotionSockets | None,
    moved: Applied,
    kept: tuple[str, Made],
) -> Any:
    name, made = kept
    if content.sh_degree:
        camera = at_rest(graph, moved, camera_place(graph))
        colour = graph.group(made.keep(build_harmonics(name, content.sh_degree)), Camera=camera)[0]
        seen = graph.store(points, names.COLOUR, "FLOAT_COLOR", colour)
        points = graph.choose("GEOMETRY", inputs[names.VIEW_COLOUR], points, seen)
    if motion is None:
        return points
    by_phase = graph.compare("EQUAL", by, names.COLOUR_ITEMS.index(names.PHASE_COLOUR), "INT")
    mapped = graph.group(
        made.keep(build_colour_map(name)),
        Amplitude=motion.amplitude,
        Phase=motion.phase,
        Colour_Range=inputs[names.COLOUR_RANGE],
        By_Phase=by_phase,
    )[0]
    shown = graph.store(points, names.COLOUR, "FLOAT_COLOR", mapped)
    analysed = graph.compare("GREATER_THAN", by, 0, "INT")
    return graph.choose("GEOMETRY", analysed, points, shown)
