"""`tg4mm view` as a user starts and ends it, and what it says to bad input."""

import signal
import socket
import subprocess
import sys
import time
import urllib.request
from contextlib import contextmanager

import pytest

from tg4mm.cli import main


@contextmanager
def started(*arguments, root):
    command = [sys.executable, "-m", "tg4mm", "view", *arguments, "--no-open", "--port", "0"]
    process = subprocess.Popen(command, cwd=root, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def test_it_serves_the_page_and_ends_cleanly_at_ctrl_c(run_path, repo_root):
    with started(str(run_path), root=repo_root) as process:
        line = process.stdout.readline()
        assert line.startswith("http://127.0.0.1:")
        assert line.endswith("(Ctrl+C ends)\n")
        with urllib.request.urlopen(line.split()[0], timeout=30) as answer:
            assert answer.status == 200
        process.send_signal(signal.SIGINT)
        begun = time.monotonic()
        out, err = process.communicate(timeout=60)
        assert time.monotonic() - begun < 20
        assert process.returncode == 0
        assert out == ""
        assert "Traceback" not in err


def test_a_port_in_use_is_one_line(run_path, capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert main(["view", str(run_path), "--no-open", "--port", port]) == 2
    err = capsys.readouterr().err
    assert err == f"tg4mm: port {port} on 127.0.0.1 is in use, or not allowed: choose another with --port\n"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--alpha", "nan"], "--alpha nan: expected a finite number"),
        (["--band", "3", "5", "--band", "6", "7"], "--band is given 2 times"),
        (["--band", "5", "90"], "reaches past half the frame rate, 7.5 Hz"),
        (["--port", "70000"], "--port 70000: expected 0 … 65535"),
    ],
)
def test_bad_options_are_one_line(run_path, options, message, capsys):
    assert main(["view", str(run_path), "--no-open", *options]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1
