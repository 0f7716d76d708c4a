"""The panel's settings become a motion description that the generator can solve."""

import numpy as np
import pytest

from dataset_gen.vibration import Body, solve

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")


@pytest.fixture
def settings(extension):
    found = bpy.context.scene.tg4mm_generate
    found.frequency, found.fps, found.amplitude = 4.0, 30.0, 0.02
    return found


@pytest.mark.parametrize(
    ("kind", "values", "keys"),
    [
        ("translate", {"direction": (1, 2, 0)}, {"direction": [1, 2, 0]}),
        ("rock", {"point": (0, 0, 0.5), "axis": (0, 1, 0.2), "phase": 0.7}, {"axis": [0, 1, 0.2], "phase": 40.10704}),
        ("twist", {"axis": (0, 0, 1), "length": 2.0}, {"length": 2.0}),
        ("twist", {"length": 0.0}, {}),
        ("bending", {"tip": (0.2, 0, 2), "order": 2}, {"order": 2}),
        ("wave", {"wavelength": 1.5, "direction": (1, 1, 0), "axis": (0, 0, 1)}, {"polarisation": [0, 0, 1]}),
        ("wave", {"rayleigh": True, "level": 2.0, "decay_length": 2.0}, {"polarisation": "rayleigh"}),
        ("jiggle", {"hold": "HEIGHT", "level": 0.4}, {"held": 0.4}),
        ("jiggle", {"hold": "POINT", "point": (2, 0, 0), "random": True}, {"held": [2, 0, 0], "direction": "random"}),
        ("membrane", {"radius": 0.9, "drum_nodes": (1, 1)}, {"nodes": [1, 1]}),
        ("plate", {"sides": (2, 2), "plate_nodes": (2, 1), "thickness": 0.2}, {"size": [2, 2], "thickness": 0.2}),
        ("group", {"group": "Loose", "direction": (0, 0, 1)}, {"group": "Loose"}),
    ],
)  # fmt: skip
def test_settings_of_every_kind_are_solved(extension, settings, kind, values, keys):
    settings.kind = kind
    for name, value in values.items():
        setattr(settings, name, value)
    mode = extension.jobs.kinds.mode(settings, [])
    assert {key: mode[key] for key in keys} == {
        key: pytest.approx(v) if v != [] else v for key, v in keys.items()
    }
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 9)] * 2, [0.0, 0.5, 1.0], indexing="ij"), -1).reshape(
        -1, 3
    )
    loose = {"Loose": np.maximum(grid[:, 0], 0)}
    body = Body("Grid", grid, np.zeros((0, 3), int), np.ones(len(grid)), loose)
    described = extension.jobs.kinds.description(settings, [])
    found = solve(described, [body], settings.fps, None, settings.seed)
    gains = found.basis_gains(np.arange(8))
    moved = np.tensordot(gains, found.basis[0], axes=(0, 0))
    assert np.linalg.norm(moved, axis=-1).max() == pytest.approx(0.02, rel=0.1)


def test_only_the_chosen_objects_move(extension, settings):
    for name, kind in (("Beam", "cube_add"), ("Weight [1]*", "ico_sphere_add")):
        getattr(bpy.ops.mesh, f"primitive_{kind}")()
        bpy.context.object.name = name
    bpy.ops.object.light_add()
    for obj in bpy.data.objects:
        obj.select_set(obj.name == "Weight [1]*" or obj.type == "LIGHT")
    assert bpy.ops.tg4mm.use_selection() == {"FINISHED"}
    chosen = extension.jobs.objects.moving(settings)
    assert [obj.name for obj in chosen] == ["Weight [1]*"]
    assert extension.jobs.objects.parts(chosen, bpy.context.evaluated_depsgraph_get()) == ["Weight [[]1][*]"]


def test_a_missing_file_is_refused(extension, settings):
    settings.source, settings.motion_file = "FILE", ""
    with pytest.raises(ValueError, match="Description is empty"):
        extension.jobs.kinds.description(settings, [])


def test_fields_from_the_cursor(extension, settings):
    cursor = bpy.context.scene.cursor
    cursor.location, cursor.rotation_euler = (1, 2, 3), (0, np.pi / 2, 0)
    for name in ("point", "axis", "level"):
        assert bpy.ops.tg4mm.mode_from_cursor(setting=name) == {"FINISHED"}
    assert tuple(settings.point) == (1, 2, 3)
    assert tuple(settings.axis) == pytest.approx((1, 0, 0), abs=1e-6)
    assert settings.level == 3


def test_instances_of_a_chosen_empty_are_parts(extension):
    inner = bpy.data.collections.new("inner")
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    bpy.context.scene.collection.objects.unlink(cube)
    inner.objects.link(cube)
    empty = bpy.data.objects.new("Stand", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", inner
    bpy.context.scene.collection.objects.link(empty)
    found = extension.jobs.objects.parts([empty], bpy.context.evaluated_depsgraph_get())
    assert found == ["Stand/*"]
