"""Generate and Train in the real Blender, by mouse: preview, progress, cancel, going on, splats at the end."""

import json
import os
import time
from pathlib import Path

import pytest

from . import looking, sidebar
from .conftest import SPLAT
from .session import ACTIVE, Session, missing

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        os.environ.get("TG4MM_GUI") != "1",
        reason=f"drives the real Blender on a virtual screen: make test-gui ({missing() or 'ready'})",
    ),
]
AMPLITUDE, TOP = 0.02, 1.0
# Stands in for the core's Python, which is not in there: says what the core says, and exports a file.
CORE = """#!/usr/bin/python3
import json, shutil, sys, time
from pathlib import Path
_, _, command, *rest = sys.argv[1:]
out = Path(rest[rest.index("--out") + 1])
if command == "train":
    for done in range(1, 41):
        event = {"tg4mm": "progress", "label": "space stage", "done": done, "total": 40, "left_s": 2.0}
        print(json.dumps(event), file=sys.stderr, flush=True)
        time.sleep(0.25)
    out.mkdir(exist_ok=True)
else:
    shutil.copyfile(Path(__file__).parent / "SPLAT", out)
"""


@pytest.fixture(scope="module")
def blender(extension_zip, splat_file):
    with Session.start(extension_zip, [splat_file]) as running:
        running.ask("cube", size=2 * TOP)
        sidebar.open_tab(running)
        yield running


def job(blender, kind):
    return blender.ask("job", kind=kind) or {"state": "", "done": 0, "total": 0, "message": "", "results": []}


def test_the_preview_moves_the_object_as_far_as_gain_says(blender, pictures):
    blender.ask(
        "put_settings", of="tg4mm_generate", kind="translate", direction=[0, 0, 1], amplitude=AMPLITUDE,
        frequency=6.0, fps=24.0, gain=10.0, out=f"{blender.inside}/sets", label="cube", timesteps=6, views=3,
        test_views=1, size=32, samples=512, alphas="5", processes=1,
    )  # fmt: skip
    before = blender.ask("highest")
    sidebar.press(blender, "bpy.ops.tg4mm.preview_start()")
    blender.wait(lambda: blender.value(f"{ACTIVE}.modifiers.keys()")[-1:] == ["TG4MM Preview"], "the preview")
    blender.run("bpy.context.scene.frame_set(2)")  # a quarter of a period after the first
    assert blender.ask("highest") == pytest.approx(before + 10 * AMPLITUDE, abs=1e-4)
    gain = sidebar.drag_setting(blender, "tg4mm_generate", "gain", 20)
    assert gain > 10.0
    assert blender.ask("highest") == pytest.approx(before + gain * AMPLITUDE, abs=1e-4)
    blender.picture(pictures / "20_preview.png")
    sidebar.press(blender, "bpy.ops.tg4mm.preview_stop()")
    blender.wait(
        lambda: "TG4MM Preview" not in blender.value(f"{ACTIVE}.modifiers.keys()"), "the end of the preview"
    )
    assert blender.ask("highest") == pytest.approx(before, abs=1e-6)
    blender.run("bpy.context.scene.frame_set(1)")


def test_a_dataset_is_begun_and_cancelled(blender, pictures):
    sidebar.press(blender, "bpy.ops.tg4mm.generate()")
    blender.wait(lambda: job(blender, "generate")["state"] == "running", "the generator")
    cancel = sidebar.find(blender, "bpy.ops.tg4mm.cancel_job(kind='generate')")
    blender.wait(lambda: job(blender, "generate")["done"] > 0, "progress", 60.0, 0.05)
    blender.picture(pictures / "21_generating.png")
    blender.click(*cancel)
    blender.wait(lambda: job(blender, "generate")["state"] == "cancelled", "the generator's end", 60.0)
    assert blender.complaints() == []


def test_it_goes_on_to_a_whole_dataset(blender, pictures):
    sidebar.press(blender, "bpy.ops.tg4mm.generate(go_on=True)")
    seen: list[int] = []

    def ended():
        now = job(blender, "generate")
        if now["total"] and now["done"] not in seen:
            seen.append(now["done"])
        return now["state"] != "running"

    blender.wait(ended, "the dataset", 400.0)
    found = job(blender, "generate")
    assert found["state"] == "done", found
    assert len(seen) > 1, found  # it told how far it was
    assert seen == sorted(seen)
    folder = blender.folder / Path(found["results"][-1]).relative_to(blender.inside)
    assert json.loads((folder / "scene.json").read_text())["fps"] == 24.0
    assert len(list(folder.glob("*/train/*.png"))) == 6 * 3
    assert blender.value("bpy.context.scene.tg4mm_train.dataset") == found["results"][-1]
    assert not looking.is_blank(blender.picture(pictures / "22_generated.png"))


def test_training_shows_progress_and_imports_what_was_trained(blender, pictures):
    core = blender.folder / "python"
    core.write_text(CORE.replace("SPLAT", SPLAT))
    core.chmod(0o755)
    preferences = "bpy.context.preferences.addons['bl_ext.user_default.tg4mm'].preferences"
    blender.run(f"{preferences}.core_python = '{blender.inside}/python'")
    sidebar.press(blender, "bpy.ops.tg4mm.train()")
    blender.wait(lambda: job(blender, "train")["done"] > 1, "progress")
    time.sleep(0.5)
    blender.picture(pictures / "23_training.png")
    blender.wait(lambda: job(blender, "train")["state"] != "running", "the end of training", 60.0)
    assert job(blender, "train")["message"].startswith("Imported: ")
    assert blender.ask("inputs")["Magnification"] == 0.0  # of the splats, which are active now
    assert blender.complaints() == []
