"""Blender 5.3's own splats: what they are given, and that a Blender without them reports it."""

import numpy as np
import pytest

from tg4mm.core.splatfile import positions_at, read_splat, rotations_at

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from tests.addon.playing import evaluated, import_splat, matrices, read, setter  # noqa: E402

needs_native = pytest.mark.skipif(
    not hasattr(bpy.types, "GeometryNodePointsSetType"), reason="this Blender has no splats of its own"
)


def test_native_is_offered_where_blender_has_it_only(extension, splat_path):
    obj, names = import_splat(splat_path), extension.names
    assert extension.compat.native_splats() == (bpy.app.version >= (5, 3, 0))
    if not extension.compat.native_splats():
        with pytest.raises(ValueError, match="'Native'; expected one of Ellipsoids, Splats, Points, Arrows"):
            setter(extension, obj)(names.DRAW, "Native")


def test_native_attributes_are_the_raw_coefficients_and_the_opacity(extension, splat_path):
    splat = read_splat(splat_path)
    made = extension.nodes.points.native_attributes(splat)
    assert list(made) == ["radiance:base", "radiance:sh_0", "radiance:sh_1", "radiance:sh_2"]
    np.testing.assert_array_equal(made["radiance:base"][:, :3], splat.sh[:, 0])
    np.testing.assert_array_equal(made["radiance:base"][:, 3], splat.opacities)
    np.testing.assert_array_equal(made["radiance:sh_2"], splat.sh[:, 3])


@needs_native
@pytest.mark.parametrize("alpha", [0.0, 20.0])
@pytest.mark.parametrize("frame", [1, 8.5])
def test_native_splats_are_where_the_formula_puts_them(extension, splat_path, alpha, frame):
    obj, names, splat = import_splat(splat_path), extension.names, read_splat(splat_path)
    put = setter(extension, obj)
    put(names.DRAW, "Native")
    put(names.ALPHA, alpha)
    put(names.SPEED, 1.0)
    geometry = evaluated(obj, frame)
    cloud, n, t = geometry.pointcloud, len(splat), frame - 1
    assert cloud.type == "GAUSSIAN_SPLAT"
    places = read(cloud, "position", "vector", 3)[:n]
    np.testing.assert_allclose(places, positions_at(splat, t, alpha), atol=1e-4 * (1 + alpha))
    turned = matrices(read(cloud, "rotation", "value", 4)[:n])
    np.testing.assert_allclose(turned, matrices(rotations_at(splat, t, alpha)), atol=2e-4 * (1 + alpha))
    np.testing.assert_allclose(read(cloud, "scale", "vector", 3)[:n], splat.scales, rtol=1e-6)
    base = read(cloud, names.NATIVE_BASE, "color", 4)[:n]
    np.testing.assert_array_equal(base[:, :3], splat.sh[:, 0])
    np.testing.assert_array_equal(base[:, 3], splat.opacities)


def test_a_node_that_is_missing_is_one_line_and_nothing_is_left(extension, splat_path, monkeypatch):
    monkeypatch.setattr(
        extension.nodes.scene,
        "build_player",
        lambda *_: extension.nodes.graph.Graph(bpy.data.node_groups.new("a", "GeometryNodeTree")).node(
            "GeometryNodeOfTomorrow"
        ),
    )
    with pytest.raises(
        RuntimeError, match=r"Blender \S+.* has no node GeometryNodeOfTomorrow; TG4MM is tested up to"
    ):
        bpy.ops.import_scene.tg4mm_splat(filepath=str(splat_path))
    assert not bpy.data.objects
    assert not bpy.data.meshes
