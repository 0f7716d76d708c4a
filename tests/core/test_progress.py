"""Progress: lines carry counts, time left and figures; a terminal gets a bar."""

import io
import os
import pty
import subprocess
import sys
import time

import pytest

from tg4mm.core.progress import HeardProgress, PlainProgress, few_lines, listened_to, progress


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


def lines(*steps, total=100, brief=False, **figures):
    """What is printed for a job of so many units; steps are (seconds since the one before, done)."""
    stream, clock = io.StringIO(), Clock()
    job = PlainProgress("space", total, "it", 0, stream, clock, brief=brief)
    for seconds, done in steps:
        clock.now += seconds
        job.update(done, **figures)
    job.finish()
    return stream.getvalue().splitlines()


def test_line_holds_counts_elapsed_time_left_and_figures():
    assert lines((10.0, 20), psnr=28.34567) == [
        "space: 20/100 it, 0:10 elapsed, 0:40 left, psnr 28.35",
        "space: 20/100 it, took 0:10, psnr 28.35",
    ]


def test_a_job_that_reports_nothing_is_shown_with_the_time_that_passes(monkeypatch, capsys):
    monkeypatch.setattr("tg4mm.core.progress._PULSE_S", 0.01)
    monkeypatch.setattr(PlainProgress, "first_s", 0.02)
    with progress("adjusting", 1, "run"):
        time.sleep(0.2)
    assert capsys.readouterr().err.startswith("adjusting: 0/1 run, 0:00 elapsed, time left unknown\n")


@pytest.mark.parametrize(("seconds", "said"), [(1.0, 0), (3.0, 2)])
def test_of_a_brief_job_nothing_is_said(seconds, said):
    assert len(lines((seconds, 2), total=4, brief=True)) == said


def test_what_the_first_of_many_units_took_does_not_count_for_the_others():
    """Kernels are compiled for a minute within the first of 1000 units, of which ten take a second."""
    printed = lines((60.0, 1), (10.0, 101), (10.0, 201), total=1000)
    assert "1:00 elapsed, time left unknown" in printed[0]
    assert "1:10 elapsed, 1:30 left" in printed[1]
    assert "1:20 elapsed, 1:20 left" in printed[2]


def test_without_a_terminal_plain_lines_go_to_stderr(capsys):
    with progress("render", 3, unit="frames") as update:
        for i in range(3):
            update(i + 1, alpha=5)
    out, err = capsys.readouterr()
    assert out == ""
    assert err == "render: 3/3 frames, took 0:00, alpha 5\n"


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_terminal_gets_a_bar_also_inside_another():
    code = (
        "from tg4mm.core.progress import progress\n"
        "with progress('outer', 2) as a:\n"
        "    with progress('inner [x]', 4, unit='frames', start=1) as b:\n"
        "        b(4, psnr=30.5)\n"
        "    a(2)\n"
    )
    master, slave = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "120"}
    subprocess.run([sys.executable, "-c", code], check=True, stderr=slave, env=environment)
    os.close(slave)
    text = b""
    try:
        while chunk := os.read(master, 65536):
            text += chunk
    except OSError:  # Linux: the other end is closed
        pass
    os.close(master)
    shown = text.decode()
    for part in ("outer", "inner [x]", "4/4", "frames", "psnr 30.5", "left", "━"):
        assert part in shown


def test_a_listener_learns_how_far_a_job_is_and_how_long_it_takes():
    now, heard = iter([0.0, 2.0, 2.1, 4.0]), list[str]()
    state = HeardProgress("frames", 40, "frames", 0, sys.stderr, lambda: next(now), listener=heard.append)
    state.update(10)
    state.update(11)  # too soon after the last line
    state.update(20)
    assert heard == ["frames: 10 of 40 frames, 0:06 left", "frames: 20 of 40 frames, 0:04 left"]


def test_only_jobs_of_the_listening_thread_are_heard(monkeypatch):
    monkeypatch.setattr(HeardProgress, "first_s", 0.0)
    heard = list[str]()
    with listened_to(heard.append), progress("one", 3) as update:
        update(1)
    with progress("two", 3) as update:
        update(1)
    assert [line.partition(":")[0] for line in heard] == ["one"]


def test_of_many_jobs_few_lines_are_shown_ever_further_apart(monkeypatch):
    clock = Clock()
    monkeypatch.setattr("tg4mm.core.progress.time.monotonic", clock)
    stream = io.StringIO()
    with few_lines():
        for number in range(60):  # of a minute each
            job = PlainProgress(f"job {number}", 60, "it", 0, stream, clock)
            for done in range(60):
                clock.now += 1.0
                job.update(done)
            job.finish()
    shown = stream.getvalue().splitlines()
    assert 12 <= len(shown) <= 20
    assert shown[0].startswith("job 0: 9/60 it")
