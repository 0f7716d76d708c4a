"""What Cycles renders against the analytic motion: determinism, exact data passes, straight alpha."""

from types import SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
OpenEXR = pytest.importorskip("OpenEXR")


from dataset_gen import build, compat, render, truth  # noqa: E402
from dataset_gen.cameras import train_cameras  # noqa: E402
from dataset_gen.errors import GenerateError  # noqa: E402
from dataset_gen.pictures import PictureFormat  # noqa: E402
from dataset_gen.prepare import builtin_bodies  # noqa: E402
from dataset_gen.render import CUT_OUT, GLASS, OPAQUE, bounces_for  # noqa: E402
from dataset_gen.scenes import SCENES  # noqa: E402
from dataset_gen.settings import Quality, motion_file  # noqa: E402
from dataset_gen.vibration import read_motion, solve  # noqa: E402
from tests.dataset_gen.sources_blends import principled  # noqa: E402
from tg4mm.core.pictures import exr  # noqa: E402

SIZE = 48
QUALITY = Quality(SIZE, SIZE, samples=4, seed=0, threads=1)
CAMERAS = train_cameras(30)
PNG = PictureFormat()


@pytest.fixture(scope="module")
def bodies():
    return builtin_bodies("mic")


@pytest.fixture(scope="module")
def motion(bodies):
    return solve(read_motion(motion_file("mic")), bodies, 30.0, None, 0)


@pytest.fixture(scope="module")
def stage():
    stage = build.build(SCENES["mic"]())
    assert render.configure(stage, QUALITY) == "CPU"
    return stage


@pytest.fixture
def move(stage, motion, bodies):
    """Puts the vertices into a state."""
    return lambda state: build.move(stage, [motion.displacement(i, state) for i in range(len(bodies))])


@pytest.fixture
def picture(stage, move, tmp_path):
    """Linear light [H, W, 4] of a state."""

    def take(state, camera=CAMERAS[5], quality=QUALITY, seed_offset=0):
        move(state)
        render.use_picture(stage, quality, seed_offset)
        build.set_view(stage, camera)
        linear = render.linear_picture(stage)
        assert not list(tmp_path.glob(".*"))  # nothing is left behind
        return linear

    return take


@pytest.fixture
def passes(stage, move, tmp_path):
    def take(state, camera=CAMERAS[5]):
        move(state)
        render.use_data(stage)
        build.set_view(stage, camera)
        return render.data_passes(stage)

    return take


def test_a_state_gives_the_same_bytes_whatever_was_rendered_before(picture, passes, motion):
    state = motion.state(1)
    first = PNG.encode(picture(state))
    picture(motion.state(4, 50.0), CAMERAS[11])
    passes(motion.state(0))
    assert PNG.encode(picture(state)) == first
    assert PNG.encode(picture(motion.state(4))) != first


def test_a_picture_with_another_seed_does_not_send_the_geometry_again(stage, picture, motion):
    picture(motion.state(1))
    seen = []

    def note(scene, depsgraph):
        seen.extend(update.id.name for update in depsgraph.updates)

    bpy.app.handlers.depsgraph_update_post.append(note)
    try:
        render.use_picture(stage, QUALITY, 7)
        bpy.context.view_layer.update()
        assert not {obj.name for obj in stage.objects} & set(seen)
        build.move(stage, stage.rest)  # the oracle can fail
        bpy.context.view_layer.update()
        assert {obj.name for obj in stage.objects} <= set(seen)
    finally:
        bpy.app.handlers.depsgraph_update_post.remove(note)


def test_magnified_is_the_mode_scaled_by_hand(stage, picture, motion, bodies, tmp_path):
    magnified = picture(motion.state(1, 20.0))
    for obj, body, shape in zip(stage.objects, bodies, motion.shapes, strict=True):
        vertices = body.vertices + 21.0 * np.sin(np.pi / 3) * -shape[0].imag
        written = np.empty(vertices.size, np.float32)
        obj.data.vertices.foreach_get("co", written)
        np.testing.assert_allclose(written.reshape(-1, 3), vertices, atol=2e-7)
        obj.data.vertices.foreach_set("co", vertices.astype(np.float32).ravel())
        obj.data.update()
    by_hand = render.linear_picture(stage)
    a, b = (PNG.pixels(linear).astype(int) for linear in (magnified, by_hand))
    assert (np.abs(a - b) > 1).mean() < 0.002  # a vertex in the last bit may send a light path elsewhere


def test_truth_file_comes_back_as_it_was_written(passes, motion, tmp_path):
    data = passes(motion.state(1))
    truth.write_exr(tmp_path / "b.exr", data)
    assert exr.complete(tmp_path / "b.exr", SIZE, SIZE)
    back = truth.read_exr(tmp_path / "b.exr")
    for name, values in data.items():
        np.testing.assert_array_equal(back[name], values)
    with OpenEXR.File(str(tmp_path / "b.exr"), separate_channels=True) as file:
        assert len(file.parts) == 1
        vectors = (f"{n}.{c}" for n in ("Normal", "Position", "Displacement") for c in "XYZ")
        assert set(file.channels()) == {"Depth.V", *vectors}


def test_blender_reads_the_same_floats_where_openexr_is_absent(stage, picture, motion, tmp_path, monkeypatch):
    picture(motion.state(0))
    monkeypatch.setattr(render.importlib.util, "find_spec", lambda name: pytest.fail(f"looked for {name}"))
    path = tmp_path / "a.exr"
    render._render_to(stage, path)
    by_blender = render.read_float_by_blender(path)
    monkeypatch.undo()
    np.testing.assert_array_equal(render.read_float(path), by_blender)
    monkeypatch.setattr(render.importlib.util, "find_spec", lambda name: None)
    np.testing.assert_array_equal(render.read_float(path), by_blender)
    assert by_blender[..., 3].max() == 1.0


class Listed:
    """Cycles' preferences as they are with some devices."""

    def __init__(self, **names):
        pairs = [(kind, name) for kind, own in names.items() for name in own]
        self.devices = [SimpleNamespace(name=name, type=kind, use=None) for kind, name in pairs]
        self.compute_device_type = "NONE"

    def get_devices_for_type(self, backend):
        if backend == "METAL":
            raise TypeError("enum METAL not found")  # as on Linux
        return [device for device in self.devices if device.type in (backend, "CPU")]


def test_the_fastest_kind_of_gpu_is_taken(stage):
    listed = Listed(CPU=["Xeon"], CUDA=["H200"], OPTIX=["H200"], HIP=["MI300"])
    assert compat.use_device(stage.scene, "auto", listed) == "OPTIX: H200"
    assert (listed.compute_device_type, stage.scene.cycles.device) == ("OPTIX", "GPU")
    assert {d.type for d in listed.devices if d.use is not False} == {"OPTIX"}
    assert compat.device_in_use(listed) == "GPU"
    assert compat.use_device(stage.scene, "cpu", listed) == "CPU"
    assert (listed.compute_device_type, stage.scene.cycles.device) == ("NONE", "CPU")


def test_without_a_gpu_auto_takes_the_processor_and_gpu_is_refused(stage):
    listed = Listed(CPU=["Xeon"])
    assert compat.use_device(stage.scene, "auto", listed) == "CPU"
    with pytest.raises(GenerateError, match=r"--device gpu: Blender finds no GPU \(looked for OPTIX, CUDA"):
        compat.use_device(stage.scene, "gpu", listed)


def in_a_group(node):
    group = bpy.data.node_groups.new("group", "ShaderNodeTree")
    group.nodes.new(node)
    material = principled("made")
    material.node_tree.nodes.new("ShaderNodeGroup").node_tree = group
    return material


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda: principled("made"), OPAQUE),
        (lambda: principled("made", Transmission_Weight=0.3), GLASS),
        (lambda: principled("made", Alpha=0.5), CUT_OUT),
        (lambda: in_a_group("ShaderNodeBsdfGlass"), GLASS),
        (lambda: in_a_group("ShaderNodeBsdfTransparent"), CUT_OUT),
    ],
)
def test_light_is_followed_through_what_lets_it_through(make, expected):
    scene = bpy.data.scenes.new("other")
    mesh = bpy.data.meshes.new("mesh")
    mesh.materials.append(make())
    scene.collection.objects.link(bpy.data.objects.new("object", mesh))
    assert bounces_for(scene) == expected
    expected.apply(scene)
    assert scene.cycles.transmission_bounces == expected.transmission
    bpy.data.scenes.remove(scene)
