"""Input that is refused leaves nothing behind, and the corrected call works."""

import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from tests.capture.sfm.videos import still, write_video
from tests.cli.test_program import refused, tg4mm

# kills after a rename, and the step between two
RENAMES = {"train": ("40", "1"), "train-paper-tuned": ("40", "5")}
OTHERS = "render measure sfm sfm-photographs generate export-usd convert-colmap"
COMMANDS = (*RENAMES, *OTHERS.split())


def pictures(folder, size):
    folder.mkdir(parents=True, exist_ok=True)
    noise = np.random.default_rng(0).integers(0, 255, (30, *size, 3), dtype=np.uint8)
    for i, picture in enumerate(noise):
        Image.fromarray(picture).save(folder / f"f_{i:02d}.png")
    return folder


@pytest.mark.parametrize("size", [(1, 1), (1, 64), (64, 1)])
@pytest.mark.parametrize("command", ["look", "sfm", "process"])
def test_pictures_of_a_pixel_a_row_or_a_column_are_refused(command, size, tmp_path):
    given = (command, pictures(tmp_path / "in", size), "--fps", "30", "--out", tmp_path / "out")
    done = tg4mm(*given)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert "expected 8 or more along each side" in done.stderr
    assert not (tmp_path / "out").exists()


def test_the_corrected_call_takes_the_folder_of_the_refused_one(tmp_path):
    """Another source with the same --out."""
    write_video(tmp_path / "a.mp4", still(12))
    for source in (pictures(tmp_path / "small", (4, 4)), tmp_path / "a.mp4"):
        done = tg4mm("sfm", source, "--fps", "30", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "scene.json").is_file()


@pytest.mark.parametrize("words", [("generate", "mic", "--out", "a\0b"), ("look", "a.mp4", "--until", "inf")])
def test_words_that_are_no_value_are_refused(words):
    pytest.importorskip("bpy")
    refused(tg4mm(*words))


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="forks")
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_that_is_killed_loses_nothing(command, repo_root):
    """In a process of its own: a fork of one that has used threads would hang."""
    if command == "generate":
        pytest.importorskip("bpy")
    renames, step = RENAMES.get(command, ("0", "1"))
    words = [sys.executable, "-m", "tests.faults.kills", "--kills", "3", "--command", command]
    words += ["--renames", renames, "--step", step]
    done = subprocess.run(words, cwd=repo_root, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    assert "seed 0: nothing lost" in done.stdout
