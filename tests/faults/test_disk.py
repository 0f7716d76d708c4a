"""A full disk and a folder that cannot be written: one line, exit 2 (the generator: 1), nothing half-written.

Small file systems need root. Without it the last test runs all of this in a namespace of its own, where Linux allows
that to everybody (`unshare -rm`).
"""

import functools
import os
import shutil
import subprocess
import sys
import tempfile

import numpy as np
import pytest
import torch

from tests.capture.conftest import write_tree
from tests.faults.readers import READERS
from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.core.errors import RunError, SplatFileError
from tg4mm.core.files import write_json
from tg4mm.core.memory import mapped_zeros
from tg4mm.core.splatfile import SplatFile, write_splat
from tg4mm.core.splatfile.spz import write_spz
from tg4mm.run import Run
from tg4mm.run.tensor_file import model_hash
from tg4mm.show.export.gltf import write_glb
from tg4mm.show.export.usd import write_usd
from tg4mm.show.render.video import write_mp4

TMPFS = ("-t", "tmpfs", "-o")
WRITERS = {
    "a.ply": write_splat,
    "a.spz": write_spz,
    "a.glb": lambda path, splat: write_glb(path, splat, np.zeros(splat.n_modes)),
    "a.usdc": lambda path, splat: write_usd(path, [(0, splat), (1, splat)], 30.0),
    "a.usda": lambda path, splat: write_usd(path, [(0, splat), (1, splat)], 30.0),
}

FULL_IN = """
import sys
from pathlib import Path
from tests.faults.test_disk import fill
from tg4mm.cli import main
from tg4mm.run import Run
import tg4mm.fit.space.train
tg4mm.fit.space.train.CHECKPOINT_EVERY_S = 0.0
stage, nth, *words = sys.argv[1:]
save, seen = Run.save_checkpoint, []
def save_checkpoint(run, own, *what):
    seen.append(own)
    if seen.count(stage) == int(nth):
        fill(run.path.parent)
    save(run, own, *what)
Run.save_checkpoint = save_checkpoint
sys.exit(main(words))
"""
SETTINGS = ("space.iterations=60", "space.max_gaussians=300", "motion.iterations=3")


def mount(*arguments):
    done = subprocess.run(["mount", *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@functools.cache
def can_mount():
    with tempfile.TemporaryDirectory() as folder:
        made = subprocess.run(["mount", *TMPFS, "size=16k", "tmpfs", folder], capture_output=True)
        return made.returncode == 0 and subprocess.run(["umount", folder]).returncode == 0


def fill(folder, left=0):
    """Fill the file system with a file `filler`, but for so many bytes."""
    room = os.statvfs(folder)
    (folder / "filler").write_bytes(b"\1" * max(room.f_bavail * room.f_frsize - left, 0))


@pytest.fixture
def disk(tmp_path):
    """`disk(kib)`: a folder on a file system of that size."""
    if not sys.platform.startswith("linux"):
        pytest.skip("a small file system needs Linux")
    if not can_mount():
        pytest.skip("a small file system needs root: see the last test")
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = []

    def make(kib):
        mount(*TMPFS, f"size={kib}k", "tmpfs", str(folder))
        mounted.append(folder)
        return folder

    yield make
    for each in mounted:
        subprocess.run(["umount", str(each)], check=True)


def frames():
    rng = np.random.default_rng(0)
    return [rng.integers(0, 256, (48, 48, 3), np.uint8) for _ in range(8)]


@pytest.mark.parametrize("kib", [4, 8, 12, 16, 20, 64])
def test_no_video_is_left_that_does_not_play(disk, kib):
    """The encoder tells a full disk by its exit status alone."""
    folder = disk(kib)
    said = r"\A[^\n]*no video could be written, ffmpeg ended with [^\n]*No space left[^\n]*\Z"
    with pytest.raises(RunError, match=said):
        write_mp4(folder / "a.mp4", frames(), 10.0, scale=4)
    assert os.listdir(folder) == []


@pytest.mark.parametrize("left", [0, 4096])
@pytest.mark.parametrize("name", WRITERS)
def test_no_export_is_left_half_written_and_the_error_says_what_to_do(name, left, disk, tmp_path):
    if name.startswith("a.usd"):
        pytest.importorskip("pxr")
    splat = SplatFile.static(*many())
    folder = disk(64)
    fill(folder, left)
    with pytest.raises(SplatFileError, match=f"{name}: cannot be written: No space left.*; make room there"):
        WRITERS[name](folder / name, splat)
    assert os.listdir(folder) == ["filler"]


def many():
    """Arrays of 4,000 Gaussians that no packing makes small."""
    values = np.random.default_rng(0).uniform(0.1, 0.9, (4000, 14)).astype(np.float32)
    return values[:, :3], values[:, 3:7], values[:, 7:10], values[:, 10], values[:, None, 11:]


def test_what_was_there_stays_whole(disk):
    folder = disk(256)
    write_json(folder / "a.json", {"old": 1})
    run = Run.create(folder / "run", folder, "modal", {})
    run.save_checkpoint("space", {"x": torch.arange(100)}, {"iteration": 1})
    fill(folder)
    with pytest.raises(OSError, match="No space left"):
        write_json(folder / "a.json", {"new": "x" * 9000})
    with pytest.raises(OSError, match="No space left"):
        run.save_checkpoint("space", {"x": torch.arange(90_000)}, {"iteration": 2})
    assert (folder / "a.json").read_text() == '{\n  "old": 1\n}\n'
    kept = run.load_checkpoint("space")
    assert kept[1] == {"iteration": 1}
    assert sorted(os.listdir(folder)) == ["a.json", "filler", "run"]
    assert sorted(os.listdir(folder / "run")) == ["checkpoint_space.safetensors", "config.json"]


def test_temporary_arrays_are_refused_before_they_are_written(disk):
    """A mapped file that finds no room on its disk ends the process by a signal."""
    folder = disk(256)
    with pytest.raises(OSError, match=r"No space left[^\n]*temporary arrays") as refused:
        mapped_zeros((1 << 20,), folder=folder, in_memory=0)
    assert str(folder) in str(refused.value)
    assert os.listdir(folder) == []
    assert mapped_zeros((1 << 14,), folder=folder, in_memory=0).sum() == 0


def test_the_generator_leaves_no_temporary_file(disk):
    from dataset_gen import tree

    folder = disk(64)
    (folder / "a").write_bytes(b"a" * 9000)
    fill(folder)
    with pytest.raises(OSError, match="No space left"):
        tree.write_bytes(folder / "truth" / "motion.npz", b"x" * 50_000)
    with pytest.raises(OSError, match="No space left"), tree.whole(folder / "b.npz") as temporary:
        np.savez(temporary, a=np.ones(9000))
    assert [p.name for p in sorted(folder.rglob("*")) if p.is_file()] == ["a", "filler"]


def tg4mm(*arguments):
    command = [sys.executable, "-m", "tg4mm", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The words of a training that has several checkpoints, but for its `--out`, and a run of it."""
    folder = tmp_path_factory.mktemp("undisturbed")
    make_synthetic_dataset(
        folder / "set", n_views=3, n_timesteps=6, size=24, freqs=(5.0,), alphas=(), n_test=0
    )
    words = [str(folder / "set"), *(part for s in SETTINGS for part in ("--set", s))]
    done = tg4mm("train", *words, "--out", folder / "run")
    assert done.returncode == 0, done.stderr
    return words, folder / "run"


@pytest.mark.slow
@pytest.mark.parametrize(("stage", "nth"), [("space", 1), ("space", 3), ("motion", 1), ("motion", 2)])
def test_a_disk_that_fills_during_a_stage_loses_nothing(stage, nth, disk, undisturbed, repo_root):
    """With room again, the same command goes on, to what an undisturbed training gives."""
    folder, (words, expected) = disk(8192), undisturbed
    command = [sys.executable, "-c", FULL_IN, stage, str(nth), "train", *words, "--out", str(folder / "run")]
    done = subprocess.run(command, cwd=repo_root, capture_output=True, text=True, timeout=300)
    assert done.returncode == 2, done.stderr
    assert "No space left" in done.stderr.strip().splitlines()[-1]
    assert "Traceback" not in done.stderr
    assert not list(folder.rglob("*.tmp*"))
    checkpoint = folder / "run" / f"checkpoint_{stage}.safetensors"
    assert checkpoint.exists() == (nth > 1)
    (folder / "filler").unlink()
    done = tg4mm("train", *words, "--out", folder / "run")
    assert done.returncode == 0, done.stderr
    assert model_hash(folder / "run") == model_hash(expected)
    assert {p.name for p in (folder / "run").iterdir()} == {p.name for p in expected.iterdir()}


@pytest.mark.slow
@pytest.mark.parametrize("command", ["train", "export", "render", "generate"])
def test_a_folder_that_cannot_be_written_is_one_line(command, disk, tmp_path):
    """Read-only as a file system is, which binds root, too."""
    (tmp_path / "set").mkdir()
    write_tree(tmp_path / "set", 6)
    (tmp_path / "made").mkdir()
    READERS["run space"].make(tmp_path / "made")
    (tmp_path / "made" / "data").mkdir(exist_ok=True)
    READERS["scene.json"].make(tmp_path / "made" / "data")
    folder = disk(64)
    mount("-o", "remount,ro", str(folder))
    given = {
        "train": ("train", tmp_path / "set", "--out", folder / "run"),
        "export": ("export", tmp_path / "made" / "run", "--format", "ply", "--out", folder / "a.ply"),
        "render": ("render", tmp_path / "made" / "run", "--alpha", "5", "--out", folder / "out"),
        "generate": ("generate", "mic", "--size", "16", "--out", folder / "sets"),
    }
    done = tg4mm(*given[command])
    assert done.returncode in (1, 2), done.stderr
    assert "Traceback" not in done.stderr, done.stderr
    last = done.stderr.strip().splitlines()[-1]
    assert str(folder) in last or "Read-only" in last, done.stderr
    assert os.listdir(folder) == []


def test_without_root_all_of_this_runs_in_a_namespace(request, repo_root):
    if can_mount():
        pytest.skip("the tests above could mount by themselves")
    alone = ["unshare", "-rm"]
    if shutil.which("unshare") is None or subprocess.run([*alone, "true"], capture_output=True).returncode:
        pytest.skip("this system gives no namespaces to users: no full disk was tested")
    chosen = ["-m", request.config.option.markexpr, "-p", "no:cacheprovider", "-p", "no:xdist"]
    command = [*alone, sys.executable, "-m", "pytest", "-q", __file__, *chosen]
    done = subprocess.run(command, cwd=repo_root, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:]
    assert " 1 skipped" in done.stdout, done.stdout[-300:]  # this test itself
