"""A command that is killed and given again leaves what one that was not does: see `kills.py`."""

import subprocess
import sys

import pytest

RENAMES = {
    "train": ("40", "1"),
    "train-paper-tuned": ("40", "5"),
}  # kills after a rename, and the step between two
COMMANDS = (
    *RENAMES,
    "render",
    "measure",
    "sfm",
    "sfm-photographs",
    "generate",
    "export-usd",
    "convert-colmap",
)


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
