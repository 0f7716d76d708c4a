"""A training that is killed and started again gives the files of one that was not: see `kills.py`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

COMMANDS = ("render", "measure", "sfm", "sfm-photographs", "generate")


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="forks")
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_that_is_killed_loses_nothing(command: str, repo_root: Path) -> None:
    if command == "generate":
        pytest.importorskip("bpy")
    words = [sys.executable, "-m", "tests.faults.kills_commands", "--kills", "3", "--command", command]
    done = subprocess.run(words, cwd=repo_root, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    assert "kills, seed 0: nothing lost" in done.stdout


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="forks")
@pytest.mark.parametrize(("preset", "step"), [("modal", "1"), ("paper-tuned", "5")])
def test_nothing_is_lost_by_kills(preset: str, step: str, repo_root: Path) -> None:
    """In a process of its own: a fork of one that has used threads would hang."""
    command = [
        sys.executable,
        "-m",
        "tests.faults.kills",
        "--preset",
        preset,
        "--kills",
        "4",
        "--renames",
        "40",
        "--step",
        step,
    ]
    done = subprocess.run(command, cwd=repo_root, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    assert "kills after a rename: nothing lost" in done.stdout
    assert "kills at random moments, seed 0: nothing lost" in done.stdout
