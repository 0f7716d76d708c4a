"""SIGTERM and SIGINT to `tg4mm generate` alone, as a scheduler sends them: nothing that it started goes on."""

import contextlib
import os
import signal
import subprocess
import sys
import time

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
BUSY_S = 5.0  # of processor time, after which a render process has loaded Blender and renders
PARENT = "import sys; from tg4mm.cli.program import main; sys.exit(main(['generate', *sys.argv[1:]]))"
BENCH = """
import sys
from tg4mm.research.bench import presets
step = presets.PresetStep("one", (sys.executable, "-c", sys.argv[1]), ())
presets.steps_of = lambda *a, **k: [step, presets.PresetStep("two", (sys.executable, "-c", "open('two', 'w')"), ())]
try:
    presets.run_preset("smoke", "out")
except KeyboardInterrupt:
    sys.exit(130)
"""


def wait_for(path, seconds=60.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if path.exists() and path.read_text():
            return path.read_text()
        time.sleep(0.05)
    raise AssertionError(f"{path} did not appear within {seconds} s")


def started(folder, repo_root, *arguments):
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
def test_a_signal_to_the_parent_ends_the_child(tmp_path, repo_root, number, manner):
    parent = started(tmp_path, repo_root, manner)
    child = int(wait_for(tmp_path / "child"))
    parent.send_signal(number)
    _, said = parent.communicate(timeout=20)
    assert parent.returncode == 130
    assert not psutil.pid_exists(child)
    assert (tmp_path / "stopped").exists() == (manner == "polite")
    assert said.strip() == "tg4mm: interrupted; run the same command again to continue"


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_kill_of_the_parent_ends_the_child(tmp_path, repo_root, monkeypatch):
    """It cannot pass a signal on."""
    monkeypatch.setitem(
        globals(), "STUB", f"from tg4mm.core.parent import end_with_parent\nend_with_parent()\n{STUB}"
    )
    parent = started(tmp_path, repo_root)
    child = psutil.Process(int(wait_for(tmp_path / "child")))
    parent.kill()
    parent.communicate(timeout=20)
    assert psutil.wait_procs([child], timeout=20)[1] == []


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_signal_to_a_benchmark_ends_its_step_and_the_rest(tmp_path, repo_root):
    environment = {**os.environ, "PYTHONPATH": str(repo_root)}
    parent = subprocess.Popen([sys.executable, "-c", BENCH, STUB], cwd=tmp_path, env=environment)
    child = int(wait_for(tmp_path / "child"))
    parent.send_signal(signal.SIGTERM)
    assert parent.wait(timeout=20) == 130
    assert not psutil.pid_exists(child)
    assert not (tmp_path / "two").exists()


def workers(pid):
    """The render processes that a process has started."""
    found = []
    for process in psutil.Process(pid).children(recursive=True):
        with contextlib.suppress(psutil.Error):
            found += [process] if any("blender_main" in word for word in process.cmdline()) else []
    return found


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_render_processes_end_as_well(tmp_path, repo_root, number):
    """In the middle of a picture that takes much longer than this test waits."""
    pytest.importorskip("bpy")
    command = [sys.executable, "-m", "tg4mm", "generate", "mic", "--out", str(tmp_path)]
    command += ["--size", "1024", "--samples", "4096", "--points", "0"]
    with subprocess.Popen(command, cwd=repo_root, stderr=subprocess.PIPE, text=True) as parent:
        end = time.monotonic() + 300
        while not any(sum(p.cpu_times()[:2]) > BUSY_S for p in workers(parent.pid)):
            assert parent.poll() is None, "the generator ended by itself"
            assert time.monotonic() < end, "no render process came to work"
            time.sleep(0.2)
        every = workers(parent.pid)
        parent.send_signal(number)
        _, alive = psutil.wait_procs(every, timeout=30)
        for process in (*alive, *psutil.Process(parent.pid).children(recursive=True)) if alive else ():
            process.kill()
        parent.communicate(timeout=60)
    assert not alive, "render processes went on"
    assert parent.returncode == 130
    assert not list(tmp_path.rglob(".*.tmp*"))
