"""SIGTERM and SIGINT to `tg4mm generate` alone, as a scheduler sends them: nothing that it started goes on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

STUB = """
import os, signal, sys, time
from pathlib import Path
def stop(number, frame):
    Path("stopped").write_text(str(number))
    sys.exit(130)
if "deaf" not in sys.argv:
    signal.signal(signal.SIGTERM, stop)
Path("child").write_text(str(os.getpid()))
time.sleep(60)
"""
PARENT = "import sys; from tg4mm.cli.program import main; sys.exit(main(['generate', *sys.argv[1:]]))"


def wait_for(path: Path, seconds: float = 60.0) -> str:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if path.exists() and path.read_text():
            return path.read_text()
        time.sleep(0.05)
    raise AssertionError(f"{path} did not appear within {seconds} s")


def started(folder: Path, repo_root: Path, *arguments: str) -> subprocess.Popen[str]:
    """`tg4mm generate` with a generator that only waits."""
    package = folder / "dataset_gen"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "__main__.py").write_text(STUB)
    environment = {**os.environ, "PYTHONPATH": str(repo_root)}
    command = [sys.executable, "-c", PARENT, *arguments]
    return subprocess.Popen(command, cwd=folder, env=environment, stderr=subprocess.PIPE, text=True)


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("manner", ["polite", "deaf"])
def test_a_signal_to_the_parent_ends_the_child(
    tmp_path: Path, repo_root: Path, number: signal.Signals, manner: str
) -> None:
    parent = started(tmp_path, repo_root, manner)
    child = int(wait_for(tmp_path / "child"))
    parent.send_signal(number)
    _, said = parent.communicate(timeout=20)
    assert parent.returncode == 130
    assert not psutil.pid_exists(child)
    assert (tmp_path / "stopped").exists() == (manner == "polite")
    assert said.strip() == "tg4mm: interrupted; run the same command again to continue"


BENCH = """
import sys
from tg4mm.bench import presets
step = presets.Step("one", (sys.executable, "-c", sys.argv[1]), ())
presets.steps_of = lambda *a, **k: [step, presets.Step("two", (sys.executable, "-c", "open('two', 'w')"), ())]
try:
    presets.run_preset("smoke", "out")
except KeyboardInterrupt:
    sys.exit(130)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_signal_to_a_benchmark_ends_its_step_and_the_rest(tmp_path: Path, repo_root: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(repo_root)}
    parent = subprocess.Popen([sys.executable, "-c", BENCH, STUB], cwd=tmp_path, env=environment)
    child = int(wait_for(tmp_path / "child"))
    parent.send_signal(signal.SIGTERM)
    assert parent.wait(timeout=20) == 130
    assert not psutil.pid_exists(child)
    assert not (tmp_path / "two").exists()


def family(pid: int) -> list[psutil.Process]:
    return psutil.Process(pid).children(recursive=True)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_render_processes_end_as_well(tmp_path: Path, repo_root: Path, number: signal.Signals) -> None:
    command = [sys.executable, "-m", "tg4mm", "generate", "mic", "--out", str(tmp_path), "--size", "64"]
    parent = subprocess.Popen(command, cwd=repo_root, stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + 120
    while not any("blender_main" in " ".join(p.cmdline()) for p in family(parent.pid)):
        assert time.monotonic() < end
        time.sleep(0.2)
    every = family(parent.pid)
    parent.send_signal(number)
    parent.communicate(timeout=60)
    assert parent.returncode == 130
    _, alive = psutil.wait_procs(every, timeout=10)
    assert not alive, [p.cmdline() for p in alive]
    assert not list(tmp_path.rglob(".*.tmp*"))
