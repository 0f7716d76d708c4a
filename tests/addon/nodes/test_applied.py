"""Apply Transform and its relatives: what is seen in the world before is seen after."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from tests.addon.conftest import some_splat
from tg4mm.core.splatfile import read_splat, write_splat

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from tests.addon.playing import (  # noqa: E402
    add_camera,
    drawn_whole,
    evaluated,
    import_files,
    import_splat,
    matrices,
    read,
    setter,
)

FRAME, ALPHA = 8, 4.0
DRAWN = ("Ellipsoids", "Splats", "Points", "Arrows") + (
    ("Native",) if hasattr(bpy.types, "GeometryNodePointsSetType") else ()
)
TURN, UNEVEN = (0.5, -0.8, 1.1), (1.0, 2.0, 0.5)
CASES = {
    "scale": {"scale": (2.5, 2.5, 2.5)},
    "uneven": {"rotation_euler": TURN, "scale": UNEVEN, "location": (1.0, -2.0, 0.5)},
    "mirror": {"scale": (-1.0, 1.0, 1.0)},
    "mirror, uneven": {"rotation_euler": TURN, "scale": (-1.0, 2.0, 0.5)},
}


class Seen(NamedTuple):
    """In the world."""

    places: np.ndarray  # [N, 3]
    shapes: np.ndarray  # [N, 3, 3] covariances; of round dots radius² on the diagonal
    colours: np.ndarray  # [N, 3]


def seen(obj):
    """What the object's modifier draws at the frame of the test."""
    geometry, world = evaluated(obj, FRAME), np.array(obj.matrix_world, float)
    cloud, instances = geometry.pointcloud, geometry.instances_pointcloud()
    references = geometry.instance_references() if cloud is None else []
    if len(references) == 1 and references[0].pointcloud is not None:  # native splats, after Apply
        world = world @ read(instances, "instance_transform", "value", 16).reshape(4, 4).T
        cloud = references[0].pointcloud
    if cloud is None:
        flat = read(instances, "instance_transform", "value", 16).reshape(-1, 4, 4)
        whole = world @ flat.transpose(0, 2, 1)
        colours = read(instances, "colour", "color", 4)[:, :3]
        return Seen(whole[:, :3, 3], whole[:, :3, :3] @ whole[:, :3, :3].transpose(0, 2, 1), colours)
    places = read(cloud, "position", "vector", 3) @ world[:3, :3].T + world[:3, 3]
    if "radiance:base" in cloud.attributes:
        shapes = matrices(read(cloud, "rotation", "value", 4)) * read(cloud, "scale", "vector", 3)[:, None]
        shown, colours = world[:3, :3] @ shapes, read(cloud, "radiance:base", "color", 4)
        is_one = colours[:, 3] > 0
        return Seen(places[is_one], (shown @ shown.transpose(0, 2, 1))[is_one], colours[is_one, :3])
    size = read(cloud, "radius", "value", 1)[:, 0] * abs(np.linalg.det(world[:3, :3])) ** (1 / 3)
    return Seen(places, size[:, None, None] ** 2 * np.eye(3), read(cloud, "colour", "color", 4)[:, :3])


def assert_alike(after, before):
    """To the rounding of float32."""
    extent = np.ptp(before.places, axis=0).max()
    assert after.places.shape == before.places.shape
    np.testing.assert_allclose(after.places, before.places, atol=2e-6 * extent)
    size = np.linalg.norm(before.shapes, axis=(1, 2))
    assert (np.linalg.norm(after.shapes - before.shapes, axis=(1, 2)) / size).max() < 2e-5
    np.testing.assert_allclose(after.colours, before.colours, atol=2e-5)


def only(*objects):
    """Select these alone; the first is active."""
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj in objects)
    bpy.context.view_layer.objects.active = objects[0]


def apply(obj):
    only(obj)
    assert bpy.ops.object.transform_apply(location=True, rotation=True, scale=True) == {"FINISHED"}
    bpy.context.view_layer.update()


def place(obj, case):
    for name, value in CASES[case].items():
        setattr(obj, name, value)
    bpy.context.view_layer.update()


def warnings(obj):
    return [warning.message for warning in obj.modifiers[0].node_warnings]


@pytest.fixture
def moving(extension, tmp_path):
    """Forty opaque Gaussians, magnified, drawn whole."""
    splat = some_splat(40)
    write_splat(tmp_path / "bell.ply", replace(splat, opacities=0.2 + 0.8 * splat.opacities))
    obj = import_splat(tmp_path / "bell.ply")
    drawn_whole(extension, obj)
    setter(extension, obj)(extension.names.ALPHA, ALPHA)
    return obj


@pytest.mark.parametrize("case", ["scale", "uneven", "mirror, uneven"])
@pytest.mark.parametrize("draw", DRAWN)
def test_apply_changes_nothing_that_is_seen(extension, moving, draw, case):
    put, names = setter(extension, moving), extension.names
    put(names.DRAW, draw)
    put(names.VIEW_COLOUR, True)
    add_camera((3.0, -4.0, 2.0), (8, 8))
    place(moving, case)
    before = seen(moving)
    assert len(before.places) == 40
    apply(moving)
    np.testing.assert_allclose(moving.matrix_world, np.eye(4), atol=1e-6)
    assert_alike(seen(moving), before)
    assert warnings(moving) == []
    # The comparison can fail.
    put(names.ALPHA, ALPHA + 0.1)
    with pytest.raises(AssertionError):
        assert_alike(seen(moving), before)


def test_apply_again_and_after_a_parent_is_cleared(extension, moving):
    parent = bpy.data.objects.new("parent", None)
    bpy.context.collection.objects.link(parent)
    parent.rotation_euler, parent.scale = (0.3, 0.2, 0.1), (2.0, 2.0, 2.0)
    moving.parent, moving.location = parent, (1.0, 0.0, 0.0)
    bpy.context.view_layer.update()
    before = seen(moving)
    only(moving)
    bpy.ops.object.parent_clear(type="CLEAR_KEEP_TRANSFORM")
    apply(moving)
    assert_alike(seen(moving), before)
    place(moving, "uneven")
    before = seen(moving)
    apply(moving)
    assert_alike(seen(moving), before)


def test_a_blend_plays_without_the_extension_after_apply_and_when_it_is_appended(extension, moving, tmp_path):
    place(moving, "uneven")
    before, path = seen(moving), tmp_path / "applied.blend"
    apply(moving)
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    extension.unregister()
    try:
        bpy.ops.wm.open_mainfile(filepath=str(path))
        assert_alike(seen(bpy.data.objects["bell"]), before)
        for link in (False, True):
            bpy.ops.wm.read_factory_settings(use_empty=True)
            with bpy.data.libraries.load(str(path), link=link) as (_, into):
                into.objects = ["bell"]
            bpy.context.collection.objects.link(into.objects[0])
            bpy.context.scene.render.fps = 24
            bpy.context.view_layer.update()
            assert_alike(seen(into.objects[0]), before)
    finally:
        extension.register()


@pytest.mark.parametrize("applied_before", [False, True])
def test_joined_objects_move_as_they_did(extension, moving, tmp_path, applied_before):
    place(moving, "uneven")
    only(moving)
    bpy.ops.object.duplicate(linked=False)
    other = bpy.context.object
    place(other, "mirror")
    both = [seen(moving), seen(other)]
    if applied_before:
        apply(other)
    only(moving, other)
    assert bpy.ops.object.join() == {"FINISHED"}
    bpy.context.view_layer.update()
    assert_alike(seen(moving), Seen(*map(np.concatenate, zip(*both, strict=True))))
    assert warnings(moving) == []
    parts = extension.nodes.points.parts(moving.data)
    assert [len(part.rows) for part in parts] == [40, 40]
    apply(moving)
    assert_alike(seen(moving), Seen(*map(np.concatenate, zip(*both, strict=True))))


def edit(obj, chosen, operator, **options):
    """Run an operator of Edit Mode on the chosen vertices."""
    only(obj)
    obj.data.vertices.foreach_set("select", chosen)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_mode(type="VERT")
    operator(**options)
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.view_layer.update()


def test_deleted_gaussians_are_missed_by_nobody(extension, moving):
    place(moving, "uneven")
    before, gone = seen(moving), np.arange(44) % 3 == 0
    gone[40:] = False
    edit(moving, gone, bpy.ops.mesh.delete, type="VERT")
    apply(moving)
    assert_alike(seen(moving), Seen(*(values[~gone[:40]] for values in before)))
    assert warnings(moving) == []


def test_what_was_applied_is_read_from_the_mesh(extension, moving, tmp_path):
    """Rows of Gaussians alone, and the map from the file's places to theirs."""
    points, splat = extension.nodes.points, read_splat(tmp_path / "bell.ply")
    place(moving, "uneven")
    matrix = np.array(moving.matrix_world)
    apply(moving)
    assert points.gaussians(moving.data).sum() == len(splat) == len(moving.data.vertices) - 4
    np.testing.assert_array_equal(points.values(moving.data, "opacity"), splat.opacities)
    (part,) = points.parts(moving.data)
    np.testing.assert_allclose(part.applied, matrix, atol=1e-5)
    np.testing.assert_array_equal(part.rows, np.arange(40))
    now = splat.means @ part.applied[:3, :3].T + part.applied[:3, 3]
    np.testing.assert_allclose(points.values(moving.data, "position"), now, atol=1e-5)
    assert points.growth(moving.data) == pytest.approx(1.0, rel=1e-4)  # 1 · 2 · ½
    unit_for = extension.preferences.unit_for
    for _ in range(2):  # scaled, and scaled and applied
        place(moving, "scale")
        assert unit_for(bpy.context, moving).per_scene_unit == pytest.approx(2.5 * points.growth(moving.data))
        apply(moving)
    assert points.growth(moving.data) == pytest.approx(6.25, rel=1e-4)
    assert unit_for(bpy.context, moving).text(0.01) == "0.0625 scene units"
    only(moving)
    bpy.ops.object.mode_set(mode="EDIT")
    assert points.growth(moving.data) == pytest.approx(6.25, rel=1e-4)
    bpy.ops.object.mode_set(mode="OBJECT")
    moving[extension.names.UNIT_SCALE] = 0.1
    assert unit_for(bpy.context, moving).text(0.01) == "1 mm"


def test_a_sequence_stays_where_it_is(extension, tmp_path):
    paths = [tmp_path / f"beat_{i:04d}.ply" for i in range(12)]
    for i, path in enumerate(paths):
        write_splat(path, some_splat(5 + i, (), degree=0))
    obj = import_files(paths)
    drawn_whole(extension, obj)
    place(obj, "uneven")
    before = seen(obj)
    assert len(before.places) == 5 + FRAME - 1
    apply(obj)
    assert_alike(seen(obj), before)
