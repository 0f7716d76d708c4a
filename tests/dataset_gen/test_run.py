"""A whole, tiny run through its processes: the tree, the links, resuming, refusing."""

import io
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("bpy")
pytest.importorskip("OpenEXR")

from dataset_gen.errors import GenerateError
from dataset_gen.options import parser, request_from
from dataset_gen.prepare import plan
from dataset_gen.processes import RunFailed
from dataset_gen.run import finish_parts, generate, missing_files, prepare_parts, render_part, save_animation
from tg4mm.core.files import _HOST
from tg4mm.core.pictures import png

TINY_OPTIONS = "--size 32 --timesteps 6 --test-views 1 --alphas 5 --samples 2 --points 300"
ROOT = Path(__file__).resolve().parents[2]


def tiny(*more):
    views = () if "handheld" in more else ("--views", "3")  # one camera: refused
    options = ["mic", "--out", "x", *TINY_OPTIONS.split(), *views, *more]
    return request_from(parser().parse_args(options)).sets[0]


TINY = tiny()


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return generate(TINY, tmp_path_factory.mktemp("set"), 2, io.StringIO())


def files(root):
    return sorted(str(path.relative_to(root)) for path in root.rglob("*") if path.is_file())


def test_the_tree_is_that_of_the_contract(made):
    expected = {"scene.json", "points3d.ply", "truth/motion.npz"}
    for t in range(6):
        expected |= {f"{t:03d}/transforms_{s}.json" for s in ("train", "test")}
        expected |= {f"{t:03d}/train/r_{i:03d}.png" for i in range(3)} | {f"{t:03d}/test/r_000.png"}
        expected |= {f"magnified/x005/{t:03d}/{n}" for n in ("transforms_test.json", "test/r_000.png")}
        expected |= {f"truth/test/{t:03d}/r_000.exr"}
    found = {name for name in files(made) if not name.startswith("report/")}
    assert found == expected
    assert (made / "report/index.html").is_file()
    assert made.name == "mic_5Hz_0_005"


def test_each_timestep_reads_as_a_nerf_synthetic_folder(made):
    image = pytest.importorskip("PIL.Image")
    for t in range(6):
        folder = made / f"{t:03d}"
        data = json.loads((folder / "transforms_train.json").read_text())
        assert data["frames"][0]["time"] == pytest.approx(t / 30)
        for frame in data["frames"]:
            rgba = np.asarray(image.open(folder / (frame["file_path"] + ".png")))
            assert rgba.shape == (32, 32, 4)
            assert rgba.dtype == np.uint8
            assert 0.02 < (rgba[..., 3] > 0).mean() < 0.5
            assert np.array(frame["transform_matrix"]).shape == (4, 4)


def test_timesteps_of_one_state_are_one_file_and_others_are_not(made):
    def inode(t, split="train"):
        return os.stat(made / f"{t:03d}/{split}/r_000.png").st_ino

    assert inode(0) == inode(3)
    assert inode(1) == inode(2)
    assert inode(4) == inode(5)
    assert len({inode(0), inode(1), inode(4)}) == 3
    assert os.stat(made / "magnified/x005/000/test/r_000.png").st_ino == inode(0, "test")


def test_resuming_renders_only_what_is_missing(made):
    pictures = [name for name in files(made) if name.endswith((".png", ".exr"))]
    before = {name: os.stat(made / name).st_mtime_ns for name in pictures}
    whole = (made / "001/train/r_001.png").read_bytes()
    for t in (1, 2):  # one state of one view
        (made / f"{t:03d}/train/r_001.png").unlink()
    (made / "004/train/r_002.png").unlink()
    (made / "004/train/r_002.png").write_bytes(whole[:100])  # its twin at timestep 5 is whole
    left = made / "001" / f".left.png.{_HOST}-999999999.tmp.png"  # of a process that is none
    left.write_bytes(b"half")
    seen = io.StringIO()
    assert generate(TINY, made.parent, 1, seen) == made
    assert "rendering: 2/2" in seen.getvalue()
    assert (made / "001/train/r_001.png").read_bytes() == whole
    assert png.complete(made / "004/train/r_002.png", 32, 32)
    assert not left.exists()
    touched = {name for name, time in before.items() if os.stat(made / name).st_mtime_ns != time}
    assert touched == {"001/train/r_001.png", "002/train/r_001.png"}


@pytest.mark.slow
def test_in_parts_the_same_files_come_out(made, tmp_path):
    stream = io.StringIO()
    folder = prepare_parts(TINY, tmp_path, 2)
    assert json.loads((folder / "parts.json").read_text())["parts"] == 2
    assert render_part(TINY, tmp_path, (2, 2), 1, stream).is_file()
    with pytest.raises(RunFailed, match="files are missing"):
        finish_parts(TINY, tmp_path, stream)
    assert not (folder.parent / "points3d.ply").exists()
    assert render_part(TINY, tmp_path, (1, 2), 1, stream).is_file()
    root = finish_parts(TINY, tmp_path, stream)
    same = [name for name in files(made) if not name.startswith("report/")]
    assert [name for name in files(root) if not name.startswith("report/")] == same
    assert all((made / name).read_bytes() == (root / name).read_bytes() for name in same)
    both = [json.loads((r / "report/timing.json").read_text())["pictures"] for r in (made, root)]
    assert both[0] >= both[1] > 0


def test_damage_is_found_and_mended(made):
    path = made / "002/train/r_002.png"
    whole = path.read_bytes()
    path.unlink()  # its twin keeps its bytes
    path.write_bytes(whole[:80] + bytes(20) + whole[100:])
    assert missing_files(plan(TINY, made.parent)) == ["002/train/r_002.png"]
    path.unlink()
    (made / "truth/motion.npz").write_bytes(b"")
    (made / "points3d.ply").write_bytes(b"")
    generate(TINY, made.parent, 1, io.StringIO())
    assert path.read_bytes() == whole
    assert missing_files(plan(TINY, made.parent)) == []
    with np.load(made / "truth/motion.npz", allow_pickle=False) as data:
        assert "mode_0" in data.files


def test_an_animation_overwrites_nothing(tmp_path):
    (tmp_path / "mine.blend").write_text("mine")
    with pytest.raises(GenerateError, match="the file exists already"):
        save_animation(TINY, tmp_path / "mine.blend")
    assert (tmp_path / "mine.blend").read_text() == "mine"


def test_with_a_part_missing_it_is_not_complete(tmp_path):
    prepare_parts(TINY, tmp_path, 2)
    with pytest.raises(RunFailed, match=r"files are missing or damaged, the first is 000/train/r_000.png"):
        finish_parts(tiny("--points", "0"), tmp_path / "other", io.StringIO())
    with pytest.raises(GenerateError, match=r"--part 3/2: expected I/N with"):
        render_part(TINY, tmp_path, (3, 2), 1, io.StringIO())


def test_a_hand_held_camera_makes_a_set_that_reads(tmp_path):
    capture = pytest.importorskip("tg4mm.capture")
    options = [
        "--cameras",
        "handheld",
        "--timesteps",
        "3",
        "--truth",
        "none",
        "--points",
        "100",
        "--size",
        "24",
    ]
    root = generate(tiny(*options), tmp_path, 1, io.StringIO())
    found = capture.load_capture(root, split="train")
    assert found.n_timesteps == len(found) == 3


@pytest.mark.slow
def test_killed_runs_go_on(tmp_path):
    command = [sys.executable, "-m", "dataset_gen", "mic", "--out", str(tmp_path), "--preset", "smoke"]
    command += ["--processes", "1"]
    settings = request_from(parser().parse_args(command[3:])).sets[0]
    every = len(plan(settings, tmp_path).shots)
    process = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL)
    end = time.monotonic() + 300
    # The timing is written after each finished picture. A count of files would not do: one picture may stand for
    # several times, and its other files come after it.
    while not list(tmp_path.glob("*/report/timing.json")):
        assert time.monotonic() < end
        time.sleep(0.01)
    process.kill()
    process.wait()
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    said = [line for line in done.stderr.splitlines() if line.startswith("rendering")]
    assert 0 < int(said[-1].split()[1].split("/")[1]) < every
    assert "complete" in done.stderr


@pytest.mark.slow
def test_inside_blender_the_same_arguments_work(tmp_path):
    """As `blender --background --python blender_main.py -- …`: whole argv, package not on the path."""
    script = ROOT / "dataset_gen/blender_main.py"
    code = (
        "import bpy, runpy, sys\n"
        f"sys.argv = ['blender', '--background', '--python', {str(script)!r}, '--', 'mic', '--out', "
        f"{str(tmp_path)!r}, '--preset', 'smoke', '--size', '32', '--timesteps', '2', '--truth', 'none']\n"
        "for name in ('PIL', 'jinja2', 'skimage', 'rich', 'cyclopts', 'plyfile', 'OpenEXR', 'torch'):\n"
        "    sys.modules[name] = None\n"
        f"runpy.run_path({str(script)!r}, run_name='__main__')"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "mic_5Hz_0_005/points3d.ply").exists()
