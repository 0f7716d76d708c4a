"""A benchmark that was killed goes on: finished runs stay as they are, and the result is that of one that was not."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from tests.research.bench.conftest import MODAL, PAPER


def command(data, out):
    settings = {**MODAL, **PAPER, "paper.motion_iterations": "60"}
    options = [part for k, v in settings.items() for part in ("--set", f"{k}={v}")]
    given = [str(data), "--out", str(out), "--same-time", "never", "--alphas", "20", *options]
    given += ["--methods", "modal,paper-tuned"]
    return [sys.executable, "-m", "tg4mm", "bench", "scenes", *given]


def figures(out):
    """What must not depend on a kill: everything but seconds and memory."""
    runs = json.loads((out / "results.json").read_text(encoding="utf-8"))["runs"]
    return [{k: run[k] for k in ("set", "row", "model", "rows", "displacement")} for run in runs]


def wait_for(process, file):
    deadline = time.monotonic() + 300
    while not file.exists():
        assert process.poll() is None, "ended before it could be killed"
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.slow
def test_killed_twice(data, tmp_path):
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    subprocess.run(command(data, whole), check=True, capture_output=True, timeout=600)
    runs = killed / "runs" / data.name
    modal = runs / "modal" / "figures.json"
    # In the middle of the second run's timesteps, then while it is scored.
    for sign in (
        runs / "paper-tuned" / "run" / "planes_0002.safetensors",
        runs / "paper-tuned" / "metrics_linear.json",
    ):
        with subprocess.Popen(
            command(data, killed), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=dict(os.environ)
        ) as process:
            wait_for(process, sign)
            process.send_signal(signal.SIGKILL)
        before = modal.stat().st_mtime_ns
        assert [run["row"] for run in figures(killed)] == ["modal"]
    subprocess.run(command(data, killed), check=True, capture_output=True, timeout=600)
    assert modal.stat().st_mtime_ns == before
    assert figures(killed) == figures(whole)
    assert not list(killed.rglob("*.tmp"))
