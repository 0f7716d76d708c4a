"""Train: the core works in the background in a Python of its own, and what it made is imported."""

import importlib.util
import sys

import pytest

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from tests.addon.jobs.jobs_kit import drawn, said, wait  # noqa: E402

KIND = "train"
# Answers as `python -m tg4mm train|export …` does; what it was asked is added to a file beside it.
STUB = """#!{python}
import os, shutil, sys, time
from pathlib import Path
from tg4mm.core.progress import emit_event, say
here = Path(__file__).parent
with open(here / "asked.txt", "a") as file:
    print(*sys.argv[1:], file=file)
_, module, command, *rest = sys.argv[1:]
out = Path(rest[rest.index("--out") + 1])
if (here / "fails").read_text() == command:
    say("error", "no luck with größe")
    sys.exit(2)
if command == "look":
    print("5.00 ± 0.01 Hz   0.2 px")
elif command in ("train", "process"):
    for label, total in (("space stage", 4), ("motion stage", 2)):
        for done in range(1, total + 1):
            emit_event("progress", label=label, done=done, total=total, left_s=2.0)
            time.sleep(0.1)
    while (here / "fails").read_text() == "hang":
        time.sleep(0.05)
    out.mkdir()
else:
    out.parent.mkdir(exist_ok=True)
    shutil.copyfile(here / "made.ply", out)
print(out)
"""


@pytest.fixture
def core(extension, splat_path, tmp_path, monkeypatch):
    """The folder of a stand-in for the core's Python, named in the preferences; and settings to train with."""
    folder = tmp_path / "the core"
    folder.mkdir()
    (folder / "made.ply").write_bytes(splat_path.read_bytes())
    (folder / "fails").write_text("nothing")
    python = folder / "python"
    # The first line of a script has no room for a path with a space, so a shell finds the interpreter.
    script = folder / "stub.py"
    script.write_text(STUB.format(python=sys.executable), encoding="utf-8")
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{script}" "$@"\n')
    python.chmod(0o755)
    monkeypatch.setattr(extension.preferences.TG4MM_defaults, "core_python", str(python))
    (tmp_path / "data set").mkdir()
    bpy.context.scene.tg4mm_train.dataset = str(tmp_path / "data set")
    return folder


def test_dataset_becomes_splats_in_the_scene(extension, core, tmp_path):
    bpy.context.scene.tg4mm_train.settings = "space.iterations=3 motion.iterations=2"
    assert bpy.ops.tg4mm.train() == {"FINISHED"}
    assert "tg4mm.cancel_job" in drawn(extension, "Train")
    seen = set()
    job = wait(extension, KIND, lambda job: seen.add(job.progress.text) or False, limit_s=30)
    splat = tmp_path / "data set_run.ply"
    assert (job.state.value, job.message) == ("done", f"Imported: {splat}")
    assert {"space stage", "motion stage"} <= {text.rsplit(" ", 3)[0] for text in seen if "left" in text}
    obj = bpy.context.object
    assert obj.name == "data set_run"
    assert extension.nodes.scene.splat_modifier(obj) is not None
    assert extension.nodes.points.gaussians(obj.data).sum() == 23
    train, export = (core / "asked.txt").read_text().splitlines()
    run, data = tmp_path / "data set_run", tmp_path / "data set"
    assert train == (
        f"-m tg4mm train {data} --out {run} --device cpu --set space.iterations=3 --set motion.iterations=2"
    )
    assert export == f"-m tg4mm export {run} --out {splat} --format ply"


@pytest.mark.parametrize("fails", ["nothing", "look"])
def test_a_video_is_looked_at_trained_and_imported(extension, core, tmp_path, fails):
    """A look that fails, as at a camera that moves, stops nothing."""
    (core / "fails").write_text(fails)
    video = tmp_path / "a film.mp4"
    video.write_bytes(b"film")
    assert bpy.ops.import_scene.tg4mm_video(filepath=str(video)) == {"FINISHED"}
    shown = []
    job = wait(extension, KIND, lambda job: shown.extend(drawn(extension, "Train")) or False, limit_s=30)
    out = tmp_path / "a film-out"
    assert (job.state.value, job.message) == ("done", f"Imported: {out / 'a film.ply'}")
    assert bpy.context.object.name == "a film"
    assert said(shown, "5.00 ± 0.01 Hz 0.2 px") == (fails == "nothing")
    assert any(text.startswith("progress motion stage") for text in shown)
    look, process, export = (core / "asked.txt").read_text().splitlines()
    assert look == f"-m tg4mm look {video} --out {tmp_path / 'a film-look'}"
    assert process == f"-m tg4mm process {video} --out {out} --device cpu --quick"
    assert export == f"-m tg4mm export {out / 'run'} --out {out / 'a film.ply'} --format ply"


def test_a_failed_video_is_one_line(extension, core, tmp_path):
    (core / "fails").write_text("process")
    (tmp_path / "film.mp4").write_bytes(b"film")
    bpy.ops.import_scene.tg4mm_video(filepath=str(tmp_path / "film.mp4"))
    job = wait(extension, KIND, limit_s=30)
    assert (job.state.value, job.message) == ("failed", "no luck with größe")
    with pytest.raises(RuntimeError, match="Video: file /no/such does not exist"):
        bpy.ops.import_scene.tg4mm_video(filepath="/no/such")


def test_a_generated_dataset_is_trained_on_request(extension, core, tmp_path):
    """By a stand-in for the generator, whose end is all that counts."""
    generating, training, scene = extension.jobs.generating, extension.jobs.training, bpy.context.scene
    dataset = scene.tg4mm_train.dataset
    code = f"from tg4mm.core.progress import emit_event; emit_event('complete', path={dataset!r})"
    step = extension.jobs.runner.JobStep("render", (sys.executable, "-c", code))

    def generated():
        end = lambda job: generating._ended(job, tmp_path / "none", training.start_after)  # noqa: E731
        extension.jobs.commands.start("generate", [step], end)
        return wait(extension, "generate", limit_s=30)

    scene.tg4mm_train.dataset, scene.tg4mm_generate.then_train = "", True
    assert generated().message == f"Complete: {dataset}"
    assert wait(extension, KIND, limit_s=30).state.value == "done"
    assert bpy.context.object.name == "data set_run"
    (core / "python").unlink()
    failed = generated()
    assert failed.state.value == "failed"
    assert failed.message.startswith("generated, but not trained: Python of the Core")


@pytest.mark.parametrize("command", ["train", "export"])
def test_failure_is_one_line_and_imports_nothing(extension, core, command):
    (core / "fails").write_text(command)
    bpy.ops.tg4mm.train()
    job = wait(extension, KIND, limit_s=30)
    assert (job.state.value, job.message) == ("failed", "no luck with größe")
    assert not bpy.data.objects
    assert said(drawn(extension, "Train"), "no luck with größe")
    assert "tg4mm.train" in drawn(extension, "Train")


def test_training_can_be_stopped(extension, core):
    (core / "fails").write_text("hang")
    bpy.ops.tg4mm.train()
    wait(extension, KIND, lambda job: job.progress.text.startswith("motion stage 2/2"), limit_s=30)
    assert bpy.ops.tg4mm.cancel_job(kind=KIND) == {"FINISHED"}
    job = wait(extension, KIND, limit_s=30)
    assert job.state.value == "cancelled"
    assert len((core / "asked.txt").read_text().splitlines()) == 1
    assert not bpy.data.objects


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"dataset": ""}, "Dataset is empty: choose a folder"),
        ({"dataset": "/no/such"}, "Dataset: folder /no/such does not exist"),
        ({"run": "//x"}, "Run //x lies beside the .blend file, which is not saved yet"),
        ({"run": "DATASET/run"}, "is inside the dataset"),
    ],
)
def test_refusals(extension, core, values, message):
    for name, value in values.items():
        settings = bpy.context.scene.tg4mm_train
        setattr(settings, name, value.replace("DATASET", settings.dataset))
    with pytest.raises(RuntimeError, match=message):
        bpy.ops.tg4mm.train()


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="needs tg4mm's extra core")
def test_generated_trained_imported_by_the_real_core(extension, tmp_path, monkeypatch):
    monkeypatch.setattr(extension.preferences.TG4MM_defaults, "core_python", sys.executable)
    bpy.ops.mesh.primitive_cube_add(size=1)
    bpy.ops.object.light_add(type="SUN")
    settings = bpy.context.scene.tg4mm_generate
    settings.kind, settings.amplitude, settings.frequency, settings.fps = "translate", 0.05, 7.5, 30.0
    settings.views, settings.test_views, settings.timesteps, settings.size = 6, 1, 8, 32
    settings.samples, settings.alphas, settings.out, settings.processes = 1, "5", str(tmp_path), 1
    bpy.ops.tg4mm.generate()
    assert wait(extension, "generate").state.value == "done"
    bpy.context.scene.tg4mm_train.settings = "space.iterations=20 motion.components=2 motion.iterations=10"
    bpy.ops.tg4mm.train()
    job = wait(extension, KIND, limit_s=300)  # half a minute where nothing else runs
    assert job.state.value == "done", job.message
    assert len(bpy.context.object.data.vertices) > 10
    assert list(bpy.context.object[extension.names.FREQUENCIES])
