"""Background programs: what they say is read without waiting, and they can always be ended."""

import importlib
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

STUBBORN = """
import os, signal, subprocess, sys, time
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, signal.SIG_IGN)
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(99)"])
from tg4mm.core.progress import emit_event
emit_event("progress", label="pids", done=os.getpid(), total=child.pid)
time.sleep(99)
"""


@pytest.fixture(scope="module")
def jobs():
    """The modules of addon/jobs that need no Blender."""
    return importlib.import_module("addon").jobs


@pytest.fixture
def step(jobs, tmp_path):
    """step(code): a program of Python code."""

    def make(code, label="working"):
        path = tmp_path / f"program_{len(list(tmp_path.iterdir()))}.py"
        path.write_text(code, encoding="utf-8")
        return jobs.runner.JobStep(label, (sys.executable, str(path)))

    return make


def run(job, until=lambda: False, limit_s=20.0):
    """Poll a job until it ends, or until a condition; the progress it showed on the way."""
    seen: list[Any] = []
    begun = time.monotonic()
    while job.running and not until():
        assert time.monotonic() - begun < limit_s, f"{job.state}: {job.progress} {job.message}"
        job.poll()
        if not seen or seen[-1] != job.progress:
            seen.append(job.progress)
        time.sleep(0.01)
    return seen


def environment(jobs):
    return jobs.commands.environment()


def alive(pid):
    """Whether a process is there and not a zombie."""
    try:
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False


def event(kind, **fields):
    return json.dumps({"tg4mm": kind, **fields})


@pytest.fixture
def emitted(monkeypatch, capsys):
    """Lines that the programs write on stderr where events are asked for."""
    monkeypatch.setenv("TG4MM_EVENTS", "json")
    return lambda: capsys.readouterr().err.splitlines()


def test_progress_is_what_the_programs_print(jobs, emitted):
    from tg4mm.core.progress import EventProgress

    core = EventProgress("space stage", 30, "it", 0, sys.stderr, clock=iter([0.0, 6.0, 7.0]).__next__)
    core.update(10, psnr=21.5)
    core.finish()
    first, last = (jobs.runner.read_line(line).progress for line in emitted())
    assert first == jobs.runner.Progress("space stage", 10, 30, 12.0)
    assert first.text == "space stage 10/30, 0:12 left"
    assert (last.done, last.left_s) == (10, None)  # it ended early


def test_what_the_programs_say_is_read(jobs, emitted):
    from dataset_gen.__main__ import main as generator
    from tg4mm.cli import main
    from tg4mm.core.progress import emit_event, say

    assert main(["convert", "/no/ä", "--out", "/no/run"]) == 2  # needs nothing that Blender's Python lacks
    assert generator(["mic", "--size", "-1", "--out", "/no/out"]) == 2
    say("warning", "floor far wider", "warning: ")
    say("note", "compiling kernels")
    emit_event("complete", path="/data/a b/ü_5Hz")
    core, made, warning, note, complete = (jobs.runner.read_line(line) for line in emitted())
    assert core.error == "/no/ä: does not exist"
    assert "--size" in made.error
    assert warning.warning == "floor far wider"
    assert note.progress == jobs.runner.Progress("compiling kernels")
    assert complete.result == "/data/a b/ü_5Hz"


def test_chain_of_programs_runs_to_its_end(jobs, step):
    first = step("import time\nfrom tg4mm.core.progress import emit_event, say\nfor i in range(3):\n"
                 "    emit_event('progress', label='one', done=i, total=3)\n    time.sleep(0.05)\n"
                 "say('warning', 'floor far wider')\nemit_event('complete', path='/data/a b/mic')")  # fmt: skip
    second = step(f"print({event('progress', label='two', done=7, total=9)!r})", "second")
    job = jobs.runner.Job([first, second], environment(jobs))
    seen = run(job)
    assert (job.state, job.results) == (jobs.runner.JobState.DONE, ["/data/a b/mic"])
    assert list(job.warnings) == ["floor far wider"]
    assert seen[0].label in ("working", "one")  # which of them depends on the machine's load
    assert seen[-1].label == "two"
    assert seen[-1].factor == pytest.approx(7 / 9)


@pytest.mark.parametrize(
    ("code", "message"),
    [
        (
            "import tg4mm.core.progress as e; print('x'); e.say('error', 'no /ä'); print('y'); raise SystemExit(2)",
            "no /ä",
        ),
        ("raise RuntimeError('kaputt')", "ended with status 1: RuntimeError: kaputt"),
        ("import sys; sys.exit(5)", "ended with status 5: no output"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", "ended with status -9: no output"),
    ],
)  # fmt: skip
def test_failure_is_one_line(jobs, step, code, message):
    job = jobs.runner.Job([step(code), step("print('never')")], environment(jobs))
    run(job)
    assert (job.state, job.message) == (jobs.runner.JobState.FAILED, message)


def test_flood_of_lines_does_not_hold_up_a_poll(jobs, step, monkeypatch):
    read: list[str] = []
    read_line = jobs.runner.read_line
    monkeypatch.setattr(jobs.runner, "read_line", lambda text: read.append(text) or read_line(text))
    job = jobs.runner.Job([step("for i in range(20_000): print('line', i)")], environment(jobs))
    most, before = 0, 0
    while job.running:
        job.poll()
        most, before = max(most, len(read) - before), len(read)
        time.sleep(0.002)
    assert job.state is jobs.runner.JobState.DONE
    assert len(read) == 20_000
    assert 0 < most <= 2000


def test_poll_returns_at_once_while_a_program_hangs_and_cancel_ends_it(jobs, step):
    code = (
        "import time\nimport tg4mm.core.progress as p\np.emit_event('progress', label='ready', done=1, total=2)\n"
        "try:\n    time.sleep(99)\nexcept KeyboardInterrupt:\n    raise SystemExit(130)"
    )
    job = jobs.runner.Job([step(code), step("print('never')")], environment(jobs))
    run(job, until=lambda: job.progress.label == "ready")
    begun = time.monotonic()
    assert job.poll() is False
    assert time.monotonic() - begun < 0.5
    job.cancel()
    assert job.cancelling
    job.cancel()
    run(job, limit_s=jobs.runner.PATIENCE_S)
    assert (job.state, job.message) == (jobs.runner.JobState.CANCELLED, "Stopped")
    assert not job.cancelling


@pytest.mark.parametrize("how", ["cancel", "close"])
def test_program_that_will_not_end_is_killed_with_what_it_started(jobs, step, how, monkeypatch):
    monkeypatch.setattr(jobs.runner, "PATIENCE_S", 0.1)
    job = jobs.runner.Job([step(STUBBORN)], environment(jobs))
    run(job, until=lambda: job.progress.label == "pids")
    pids = job.progress.done, job.progress.total
    assert all(alive(pid) for pid in pids)
    getattr(job, how)()
    run(job)
    assert job.state is jobs.runner.JobState.CANCELLED
    begun = time.monotonic()
    while any(alive(pid) for pid in pids):
        assert time.monotonic() - begun < 5
        time.sleep(0.01)


def test_child_that_outlives_its_parent_does_not_hold_the_job(jobs, step):
    code = "import subprocess, sys\nsubprocess.Popen([sys.executable, '-c', 'import time; time.sleep(4)'])"
    job = jobs.runner.Job([step(code)], environment(jobs))
    run(job, limit_s=3.5)
    assert job.state is jobs.runner.JobState.DONE


def test_environment_takes_nothing_from_the_folder_a_program_runs_in(jobs, step, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONHOME", "/blender/python")
    (tmp_path / "planted.py").write_text("print('planted')")
    monkeypatch.chdir(tmp_path)
    job = jobs.runner.Job(
        [jobs.runner.JobStep("import", (sys.executable, "-c", "import planted"))], environment(jobs)
    )
    run(job)
    assert job.message.endswith("No module named 'planted'")
    assert "PYTHONHOME" not in environment(jobs)
    assert os.environ["PYTHONHOME"] == "/blender/python"
