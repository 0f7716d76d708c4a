"""Generate: the open scene becomes a dataset in the background, can be stopped and gone on with."""

import json
from pathlib import Path

import numpy as np
import pytest

from tg4mm.capture import load_capture, load_images

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from tests.addon.jobs.jobs_kit import drawn, said, wait  # noqa: E402
from tests.addon.playing import import_splat  # noqa: E402

KIND = "generate"


@pytest.fixture
def settings(extension, tmp_path):
    """A scene of two cubes and a lamp, of which one rocks; the smallest dataset."""
    bpy.ops.mesh.primitive_cube_add(size=1)
    bpy.context.object.name = "Cube [a]"
    bpy.ops.mesh.primitive_cube_add(size=1, location=(2, 0, 0))
    bpy.context.object.name = "Still"
    bpy.ops.object.light_add(type="SUN")
    found = bpy.context.scene.tg4mm_generate
    found.moving.add().object = bpy.data.objects["Cube [a]"]
    found.kind, found.axis, found.point = "rock", (0, 1, 0), (0, 0, -0.5)
    found.frequency, found.fps, found.timesteps, found.amplitude = 7.5, 30.0, 3, 0.1
    found.views, found.test_views, found.size, found.samples = 3, 1, 32, 1
    found.alphas, found.label, found.processes = "5", "cubes", 1
    found.out = str(tmp_path / "großer Ausgang")
    return found


def test_scene_becomes_a_dataset(extension, settings, splat_path):
    splat = import_splat(splat_path)
    bpy.context.scene.frame_set(4)
    assert bpy.ops.tg4mm.generate() == {"FINISHED"}
    assert not splat.hide_render
    out = Path(settings.out)
    assert (out / "cubes.generating" / "scene.blend").is_file()
    seen = set()
    job = wait(extension, KIND, lambda job: seen.add(job.progress.text) or False)
    assert job.state.value == "done", job.message
    root = out / "cubes_7_5Hz_0_1"
    assert job.message == f"Complete: {root}"
    assert any(text.startswith("rendering ") for text in seen)
    assert Path(bpy.context.scene.tg4mm_train.dataset) == root
    assert [path.name for path in out.iterdir()] == [root.name]  # the copy of the scene is gone

    capture = load_capture(root, split="train")
    assert (capture.n_timesteps, capture.fps) == (3, 30.0)
    assert load_images(capture).data.shape == (9, 32, 32, 4)
    about = json.loads((root / "scene.json").read_text())
    assert about["truth"] == "none"
    assert about["modes"] == extension.jobs.kinds.description(settings, ["Cube [[]a]"]).to_json()["modes"]
    with np.load(root / "truth" / "motion.npz") as motion:
        assert list(motion["objects"]) == ["Cube [a]", "Still"]  # no splats
        assert np.linalg.norm(motion["mode_0"], axis=-1).max() == pytest.approx(0.1, rel=1e-5)
        assert not motion["mode_1"].any()
    shown = drawn(extension, "Generate")
    assert said(shown, f"Complete: {root}")
    assert {"tg4mm.generate"} == {name for name in shown if name.startswith("tg4mm.")}


def test_stopped_run_goes_on(extension, settings):
    settings.timesteps, settings.views = 8, 6
    assert bpy.ops.tg4mm.generate() == {"FINISHED"}
    shown = drawn(extension, "Generate")
    assert any(text.startswith("progress ") for text in shown)
    assert "tg4mm.cancel_job" in shown
    assert "tg4mm.generate" not in shown
    with pytest.raises(RuntimeError, match="poll"):
        bpy.ops.tg4mm.generate()
    out = Path(settings.out)
    wait(extension, KIND, lambda job: any(out.glob("cubes_*/000/train/r_*.png")))
    assert bpy.ops.tg4mm.cancel_job(kind=KIND) == {"FINISHED"}
    assert "progress Stopping" in drawn(extension, "Generate")
    job = wait(extension, KIND, limit_s=20)
    assert (job.state.value, job.message) == ("cancelled", "Stopped")
    assert bpy.ops.tg4mm.cancel_job(kind=KIND) == {"FINISHED"}  # nothing to stop
    first = next(out.glob("cubes_*/000/train/r_*.png"))
    written = first.stat().st_mtime_ns
    assert "Resume" in drawn(extension, "Generate")

    settings.timesteps = 3  # not what was begun
    assert bpy.ops.tg4mm.generate(go_on=True) == {"FINISHED"}
    job = wait(extension, KIND)
    assert job.state.value == "failed"
    assert "was made with" in job.message
    settings.timesteps = 8
    bpy.data.objects["Still"].location.x = 5  # the copy is as it was
    assert bpy.ops.tg4mm.generate(go_on=True) == {"FINISHED"}
    job = wait(extension, KIND)
    assert job.state.value == "done", job.message
    assert first.stat().st_mtime_ns == written
    assert load_capture(job.results[-1], split="train").n_timesteps == 8
    assert "Resume" not in drawn(extension, "Generate")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"out": ""}, "Output is empty"),
        ({"out": "//here"}, "not saved yet"),
        ({"label": "../x"}, "Name '../x': use letters, digits"),
        ({"frequency": 15.0}, "Frequency 15 Hz is not below half of the Frame Rate, 15 Hz"),
        ({"axis": (0, 0, 0)}, "axis: .* has no direction"),
        ({"source": "FILE", "motion_file": "/no/such.yaml"}, "/no/such.yaml cannot be read"),
    ],
)
def test_refusals_come_before_anything_is_written(extension, settings, values, message, tmp_path):
    before = sorted(tmp_path.rglob("*"))
    for name, value in values.items():
        setattr(settings, name, value)
    with pytest.raises(RuntimeError, match=message):
        bpy.ops.tg4mm.generate()
    assert sorted(tmp_path.rglob("*")) == before
    assert extension.jobs.commands.get(KIND) is None


def test_core_python_runs_the_generator_where_it_is_named(extension, settings, monkeypatch, tmp_path):
    stub = tmp_path / "python"
    event = '{"tg4mm": "error", "message": "not today"}'
    stub.write_text(f'#!/bin/sh\necho "$@" >> "$0.said"\necho \'{event}\' >&2\nexit 2\n')
    stub.chmod(0o755)
    monkeypatch.setattr(extension.preferences.TG4MM_defaults, "core_python", str(stub))
    settings.truth = "test"
    assert "truth" in drawn(extension, "Cameras and Pictures")
    bpy.ops.tg4mm.generate()
    assert wait(extension, KIND).message == "not today"
    said = Path(f"{stub}.said").read_text()
    assert said.startswith("-m dataset_gen --blend ")
    assert "--truth test" in said


def test_disabling_the_extension_ends_the_run(extension, settings):
    bpy.ops.tg4mm.generate()
    job = extension.jobs.commands.get(KIND)
    extension.unregister()
    assert job.state.value == "cancelled"
    assert job._program.process.poll() is not None
    extension.register()
