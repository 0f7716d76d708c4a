"""The preview moves what the generator would move, as far and when, and leaves nothing behind."""

import json

import numpy as np
import pytest

from dataset_gen.vibration import Body, MotionDescription, solve

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from tests.addon.playing import blocks  # noqa: E402

GAIN = 25.0


def add(kind, name, **where):
    """A primitive, "cube_add" and the like, under a name."""
    getattr(bpy.ops.mesh, f"primitive_{kind}_add")(**where)
    bpy.context.object.name = name
    return bpy.context.object


@pytest.fixture
def scene(extension):
    """A beam, turned, squeezed and subdivided; a child of it; a plate with a vertex group; a lamp."""
    beam = add("cube", "Beam", location=(0.2, 0, 1), rotation=(0.2, 0.3, 0.4), scale=(0.1, 0.2, 1))
    beam.modifiers.new("smooth", "SUBSURF").levels = 2
    child = add("ico_sphere", "Weight [1]*", location=(0, 0, 1.2), scale=(0.3, 0.3, 0.1))
    child.parent = beam
    plate = add("grid", "Plate", size=2, x_subdivisions=8, y_subdivisions=8, location=(2, 0, 0.5))
    group = plate.vertex_groups.new(name="Loose")
    for i, vertex in enumerate(plate.data.vertices):
        if vertex.co.x > 0:
            group.add([i], float(vertex.co.x), "REPLACE")
    bpy.ops.object.light_add()
    settings = bpy.context.scene.tg4mm_generate
    settings.gain, settings.frequency, settings.fps, settings.amplitude = GAIN, 4.0, 30.0, 0.02
    bpy.context.scene.frame_start = 3
    return bpy.context.scene


def bodies(frame, names):
    """The evaluated vertices of objects at a frame, world space."""
    bpy.context.scene.frame_set(int(np.floor(frame)), subframe=float(frame % 1))
    depsgraph = bpy.context.evaluated_depsgraph_get()
    found = []
    for name in names:
        obj = bpy.data.objects[name].evaluated_get(depsgraph)
        local = np.empty(3 * len(obj.data.vertices), np.float32)
        obj.data.vertices.foreach_get("co", local)
        matrix = np.array(obj.matrix_world)
        world = local.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
        found.append(Body(name, world, np.zeros((0, 3), int), np.ones(len(world)), weights(obj, world)))
    return found


def weights(obj, world):
    if "Loose" not in obj.vertex_groups:
        return {}
    return {"Loose": np.maximum(np.array([v.co.x for v in obj.data.vertices]), 0.0)}


def expected_motion(extension, rest, parts):
    """Solved by the generator's own package from the description that the panel makes."""
    settings = bpy.context.scene.tg4mm_generate
    described = extension.jobs.kinds.description(settings, parts).to_json()
    return solve(MotionDescription.from_json(described), rest, settings.fps, None, settings.seed)


def check(extension, names, parts, largest=0.02):
    """Start the preview: at several frames the vertices must lie where the motion has them."""
    rest = bodies(3, names)
    motion = expected_motion(extension, rest, parts)
    assert bpy.ops.tg4mm.preview_start() == {"FINISHED"}
    seen = 0.0
    for frame in (3, 4, 6.25, 11, 40):
        gains = motion.basis_gains(np.array([frame - 3.0]))[:, 0]
        for i, (now, at_rest) in enumerate(zip(bodies(frame, names), rest, strict=True)):
            shift = np.tensordot(gains, motion.basis[i], axes=1)
            np.testing.assert_allclose(now.vertices - at_rest.vertices, GAIN * shift, atol=1e-5)
            seen = max(seen, float(np.abs(shift).max(initial=0.0)))
    assert seen > 0.3 * largest  # there was something to compare


ALL = ("Beam", "Weight [1]*", "Plate")


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ("translate", {"direction": (1, 2, 0)}),
        ("rock", {"point": (0, 0, 0.5), "axis": (0, 1, 0.2), "phase": 0.7}),
        ("twist", {"point": (0, 0, 0), "axis": (0, 0, 1), "length": 2.0}),
        ("twist", {"length": 0.0}),
        ("bending", {"point": (0.2, 0, 0), "tip": (0.2, 0, 2), "order": 2}),
        ("wave", {"wavelength": 1.5, "direction": (1, 1, 0), "axis": (0, 0, 1)}),
        ("wave", {"wavelength": 1.5, "rayleigh": True, "level": 2.0, "decay_length": 2.0}),
        ("jiggle", {"hold": "HEIGHT", "level": 0.4, "reach": 1.0}),
        ("jiggle", {"hold": "POINT", "point": (2, 0, 0), "reach": 0.5, "random": True, "seed": 4}),
        ("membrane", {"point": (2, 0, 0.5), "radius": 0.9, "drum_nodes": (1, 1)}),
        ("plate", {"point": (2, 0, 0.5), "sides": (2, 2), "plate_nodes": (2, 1), "thickness": 0.2}),
        ("group", {"group": "Loose", "direction": (0, 0, 1)}),
    ],
)
def test_every_kind_moves_as_the_generator_moves_it(extension, scene, kind, values):
    settings = scene.tg4mm_generate
    settings.kind = kind
    for name, value in values.items():
        setattr(settings, name, value)
    check(extension, ALL, [])


def test_only_the_chosen_objects_move(extension, scene):
    scene.tg4mm_generate.kind = "translate"
    for obj in bpy.data.objects:
        obj.select_set(obj.name == "Weight [1]*" or obj.type == "LIGHT")
    assert bpy.ops.tg4mm.use_selection() == {"FINISHED"}
    assert [item.object.name for item in scene.tg4mm_generate.moving] == ["Weight [1]*"]
    check(extension, ALL, ["Weight [[]1][*]"])
    assert [obj.name for obj in bpy.data.objects if extension.jobs.preview.MODIFIER in obj.modifiers] == [
        "Weight [1]*"
    ]


def test_modes_of_a_file_ring_down_and_drift(extension, scene, tmp_path):
    modes = [
        {"name": "a", "kind": "rock", "pivot": [0, 0, 0], "axis": [1, 0, 0], "frequency": 3.3, "amplitude": 0.02,
         "decay": 0.4, "phase": 20},
        {"name": "b", "kind": "drift", "direction": [0, 1, 0], "rate": 0.01},
        {"name": "c", "kind": "wave", "direction": [1, 0, 0], "wavelength": 1.0, "polarisation": [0, 0, 1],
         "frequency": 7, "amplitude": 0.01, "parts": ["Pl*"]},
    ]  # fmt: skip
    path = tmp_path / "motion.json"
    path.write_text(json.dumps({"modes": modes}))
    scene.tg4mm_generate.source, scene.tg4mm_generate.motion_file = "FILE", str(path)
    check(extension, ALL, [])


def test_amplitude_in_pixels_is_that_of_the_first_camera(extension, scene):
    from dataset_gen.vibration import pixel_displacement

    settings = scene.tg4mm_generate
    settings.kind, settings.amplitude_in, settings.amplitude_px, settings.gain = (
        "translate",
        "PIXELS",
        0.7,
        1.0,
    )
    settings.direction, settings.frequency, settings.fps, settings.size = (0, 0, 1), 7.5, 30.0, 200
    rest = bodies(3, ALL)
    assert bpy.ops.tg4mm.preview_start() == {"FINISHED"}
    shift = [now.vertices - then.vertices for now, then in zip(bodies(4, ALL), rest, strict=True)]
    camera = extension.jobs.kinds.reference_camera(settings, rest, scene)
    focal = camera.focal(200)
    pixels = [
        pixel_displacement(body.vertices, moved.astype(complex), camera.camera_to_world, focal, focal)
        for body, moved in zip(rest, shift, strict=True)
    ]
    assert max(pixels) == pytest.approx(0.7, rel=1e-3)


def state():
    """Everything that a preview could leave behind."""
    users = {obj.name: [m.name for m in obj.modifiers] for obj in bpy.data.objects}
    attributes = {mesh.name: sorted(a.name for a in mesh.attributes) for mesh in bpy.data.meshes}
    return {
        "blocks": blocks(),
        "modifiers": users,
        "attributes": attributes,
        "keys": len(bpy.data.shape_keys),
    }


def test_undo_takes_the_preview_away_and_redo_brings_it_back(extension, scene):
    bpy.context.preferences.edit.use_global_undo = True
    bpy.ops.ed.undo_push(message="before")
    before = state()
    bpy.ops.tg4mm.preview_start("EXEC_DEFAULT", True)
    shown = state()
    bpy.ops.ed.undo()
    assert state() == before
    assert not extension.jobs.preview.active()
    bpy.ops.ed.redo()
    assert state() == shown
    bpy.ops.tg4mm.preview_stop()
    assert state() == before


def test_gain_and_settings_change_what_is_shown(extension, scene):
    settings = scene.tg4mm_generate
    settings.kind = "translate"
    rest = bodies(3, ALL)[2].vertices
    bpy.ops.tg4mm.preview_start()
    once = bodies(4, ALL)[2].vertices - rest
    settings.gain = 2 * GAIN
    np.testing.assert_allclose(bodies(4, ALL)[2].vertices - rest, 2 * once, atol=1e-5)
    settings.direction, settings.amplitude = (0, 0, 1), 0.04
    extension.jobs.preview.refresh()  # the timer's, which does not run here
    moved = bodies(4, ALL)[2].vertices - rest
    np.testing.assert_allclose(moved[:, 2], 4 * once[:, 0], atol=1e-5)
    assert np.abs(moved[:, :2]).max() < 1e-5


def test_refresh_that_fails_says_why(extension, scene):
    before = state()
    bpy.ops.tg4mm.preview_start()
    scene.tg4mm_generate.frequency = 20.0
    extension.jobs.preview.refresh()
    assert state() == before
    assert "20 Hz is not below half the frame rate" in extension.jobs.preview.problem()
    scene.tg4mm_generate.frequency = 2.0
    bpy.ops.tg4mm.preview_start()
    assert extension.jobs.preview.problem() == ""


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"frequency": 15.0}, r"frequency 15 Hz is not below half the frame rate, 15 Hz \(fps 30\)"),
        ({"kind": "bending", "tip": (0, 0, 0)}, "the beam has no length"),
        ({"kind": "group", "group": "Nobody"}, "no part has the vertex group 'Nobody'"),
        ({"kind": "jiggle", "level": 50.0}, "it moves no vertex"),
        ({"source": "FILE", "motion_file": ""}, "Description is empty"),
    ],
)
def test_refusals(extension, scene, values, message):
    for name, value in values.items():
        setattr(scene.tg4mm_generate, name, value)
    before = state()
    with pytest.raises(RuntimeError, match=message):
        bpy.ops.tg4mm.preview_start()
    assert state() == before


def test_fields_from_the_cursor(extension):
    cursor, settings = bpy.context.scene.cursor, bpy.context.scene.tg4mm_generate
    cursor.location, cursor.rotation_euler = (1, 2, 3), (0, np.pi / 2, 0)
    for name in ("point", "axis", "level"):
        assert bpy.ops.tg4mm.mode_from_cursor(setting=name) == {"FINISHED"}
    assert tuple(settings.point) == (1, 2, 3)
    assert tuple(settings.axis) == pytest.approx((1, 0, 0), abs=1e-6)
    assert settings.level == 3


def test_instances_of_a_chosen_empty_are_parts(extension):
    inner = bpy.data.collections.new("inner")
    cube = add("cube", "Cube")
    bpy.context.scene.collection.objects.unlink(cube)
    inner.objects.link(cube)
    empty = bpy.data.objects.new("Stand", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", inner
    bpy.context.scene.collection.objects.link(empty)
    found = extension.jobs.objects.parts([empty], bpy.context.evaluated_depsgraph_get())
    assert found == ["Stand/*"]
