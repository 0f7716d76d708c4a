"""What Cycles renders against the analytic motion: determinism, exact data passes, straight alpha."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
OpenEXR = pytest.importorskip("OpenEXR")

from mathutils import Vector  # noqa: E402
from mathutils.bvhtree import BVHTree  # noqa: E402

from dataset_gen import build, points, render, truth  # noqa: E402
from dataset_gen.cameras import train_cameras  # noqa: E402
from dataset_gen.quality import Quality  # noqa: E402
from dataset_gen.scenes import SCENES  # noqa: E402
from dataset_gen.vibration import State  # noqa: E402

SIZE = 48
QUALITY = Quality(SIZE, SIZE, samples=4, seed=0)
CAMERAS = train_cameras(30)


@pytest.fixture(scope="module")
def stage():
    stage = build.build(SCENES["mic"](5.0, 0.005), 30.0)
    render.configure(stage, QUALITY)
    return stage


def picture(stage, path, state, camera=CAMERAS[5], quality=QUALITY):
    build.set_state(stage, state)
    render.use_picture(stage, quality)
    build.set_view(stage, camera.camera_to_world)
    render.render_to(stage, path)
    return path.read_bytes()


def pixels(path, size=SIZE):
    """[H, W, 4] integers, row 0 at the top."""
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    image.alpha_mode = "CHANNEL_PACKED"
    out = np.array(image.pixels[:]).reshape(size, size, 4)[::-1]
    bpy.data.images.remove(image)
    return np.round(out * 255).astype(int)


def passes(stage, path, state, camera=CAMERAS[5]):
    build.set_state(stage, state)
    render.use_data(stage)
    build.set_view(stage, camera.camera_to_world)
    render.render_to(stage, path)
    return render.read_passes(path)


def test_a_state_gives_the_same_bytes_whatever_was_rendered_before(stage, tmp_path):
    state = stage.motion.state(1)
    first = picture(stage, tmp_path / "a.png", state)
    picture(stage, tmp_path / "b.png", stage.motion.state(4, 50.0), CAMERAS[11])
    passes(stage, tmp_path / "b.exr", stage.motion.state(0))
    assert picture(stage, tmp_path / "c.png", state) == first
    assert picture(stage, tmp_path / "d.png", stage.motion.state(4)) != first


def test_another_seed_gives_another_picture(stage, tmp_path):
    state = stage.motion.state(0)
    other = Quality(SIZE, SIZE, samples=4, seed=1)
    assert picture(stage, tmp_path / "a.png", state) != picture(
        stage, tmp_path / "b.png", state, quality=other
    )


def test_magnified_is_the_mode_scaled_by_hand(stage, tmp_path):
    picture(stage, tmp_path / "a.png", stage.motion.state(1, 20.0))
    by_hand = [
        part.mesh.vertices + 21.0 * np.sin(np.pi / 3) * -shape[0].imag
        for part, shape in zip(stage.description.parts, stage.description.shapes(), strict=True)
    ]
    for obj, vertices in zip(stage.objects, by_hand, strict=True):
        written = np.empty(vertices.size, np.float32)
        obj.data.vertices.foreach_get("co", written)
        np.testing.assert_allclose(written.reshape(-1, 3), vertices, atol=2e-7)
        obj.data.vertices.foreach_set("co", vertices.astype(np.float32).ravel())
        obj.data.update()
    render.use_picture(stage, QUALITY)
    render.render_to(stage, tmp_path / "b.png")
    difference = np.abs(pixels(tmp_path / "a.png") - pixels(tmp_path / "b.png"))
    assert (difference > 1).mean() < 0.002  # a vertex in the last bit may send a light path elsewhere


def test_depth_reprojects_to_position(stage, tmp_path):
    data = passes(stage, tmp_path / "a.exr", stage.motion.state(1, 50.0))
    seen = data["Depth"] < 1e9
    assert 200 < seen.sum() < SIZE * SIZE
    assert (data["Depth"][~seen] == 1e10).all()
    xy, depth = points.project(data["Position"][seen].astype(float), CAMERAS[5], SIZE, SIZE)
    row, column = np.nonzero(seen)
    np.testing.assert_allclose(depth, data["Depth"][seen], atol=2e-5)
    np.testing.assert_allclose(xy, np.column_stack([column + 0.5, row + 0.5]), atol=0.01)


def test_displacement_pass_is_the_analytic_motion(stage, tmp_path):
    state = stage.motion.state(2, 20.0)
    data = passes(stage, tmp_path / "a.exr", state)
    seen = data["Depth"] < 1e9
    rest = (data["Position"] - data["Displacement"])[seen].astype(float)
    parts = stage.description.parts
    starts = np.cumsum([0] + [len(part.mesh.vertices) for part in parts])
    vertices = np.concatenate([part.mesh.vertices for part in parts])
    faces = np.concatenate([part.mesh.triangles + s for part, s in zip(parts, starts[:-1], strict=True)])
    moves = np.concatenate([stage.motion.displacement(i, state) for i in range(len(parts))])
    surface = BVHTree.FromPolygons(vertices.tolist(), faces.tolist(), all_triangles=True)
    error, distance = [], []
    for point, displacement in zip(rest, data["Displacement"][seen], strict=True):
        nearest, _, face, gap = surface.find_nearest(Vector(point))
        corners = vertices[faces[face]]
        weights = np.linalg.lstsq(np.vstack([corners.T, [1e3] * 3]), [*nearest, 1e3], rcond=None)[0]
        error.append(np.abs(weights @ moves[faces[face]] - displacement).max())
        distance.append(gap)
    assert (
        max(distance) < 1e-5
    )  # float32; undone by its displacement, every point seen lies on the surface at rest
    assert np.abs(data["Displacement"]).max() > 0.05
    assert np.percentile(error, 99) < 2e-6
    assert max(error) < 1e-4  # where two parts touch, the nearest triangle may be the other's


def test_still_parts_have_exactly_zero_displacement(stage, tmp_path):
    data = passes(stage, tmp_path / "a.exr", stage.motion.state(1, 50.0))
    feet = (data["Depth"] < 1e9) & (data["Position"][..., 2] < -0.5)
    feet &= np.hypot(data["Position"][..., 0], data["Position"][..., 1]) < 0.75
    assert feet.sum() > 10
    assert (data["Displacement"][feet] == 0.0).all()


def test_normals_are_unit_and_face_the_camera(stage, tmp_path):
    data = passes(stage, tmp_path / "a.exr", stage.motion.state(0))
    seen = data["Depth"] < 1e9
    normals = data["Normal"][seen]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-4)
    to_camera = CAMERAS[5].camera_to_world[:3, 3] - data["Position"][seen]
    assert ((normals * to_camera).sum(1) > -0.3).mean() > 0.99


def test_truth_file_comes_back_as_it_was_written(stage, tmp_path):
    data = passes(stage, tmp_path / "a.exr", stage.motion.state(1))
    truth.write_exr(tmp_path / "b.exr", data)
    back = truth.read_exr(tmp_path / "b.exr")
    for name, values in data.items():
        np.testing.assert_array_equal(back[name], values)
    with OpenEXR.File(str(tmp_path / "b.exr"), separate_channels=True) as file:
        assert len(file.parts) == 1
        assert sorted(file.channels()) == sorted(
            ["Depth.V", *(f"{n}.{c}" for n in ("Normal", "Position", "Displacement") for c in "XYZ")]
        )


def test_alpha_is_straight(stage, tmp_path):
    """With one colour on everything, straight alpha shows that colour in half-covered pixels too."""
    grey = bpy.data.materials.new("grey")
    grey.use_nodes = True
    tree = grey.node_tree
    tree.nodes.clear()
    emission, output = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeOutputMaterial")
    emission.inputs["Color"].default_value = (0.5, 0.5, 0.5, 1.0)
    tree.links.new(emission.outputs["Emission"], output.inputs["Surface"])
    build.set_state(stage, stage.motion.state(0))
    render.use_picture(stage, Quality(SIZE, SIZE, samples=16, seed=0))
    stage.scene.view_layers[0].material_override = grey
    build.set_view(stage, CAMERAS[5].camera_to_world)
    render.render_to(stage, tmp_path / "a.png")
    image = pixels(tmp_path / "a.png")
    partial = (image[..., 3] > 40) & (image[..., 3] < 215)
    assert partial.sum() > 50
    assert np.abs(image[partial][:, :3] - 188).max() <= 3  # sRGB of linear 0.5, rounding grows with 1/alpha
    assert (image[image[..., 3] == 0] == 0).all()


def test_rest_gain_zero_is_the_rest_mesh(stage):
    build.set_state(stage, State((0.0,)))
    for part, obj in zip(stage.description.parts, stage.objects, strict=True):
        written = np.empty(part.mesh.vertices.size, np.float32)
        obj.data.vertices.foreach_get("co", written)
        np.testing.assert_array_equal(written.reshape(-1, 3), part.mesh.vertices.astype(np.float32))
