"""One process trains a run: a second is told so, and a killed one leaves nothing in the way."""

import subprocess
import sys
from contextlib import contextmanager

from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.cli import main

HOLD = """
import sys, time
from tg4mm.run.config import work_folder
with work_folder(sys.argv[1]).held("trains it"):
    print("held", flush=True)
    time.sleep(600)
"""


@contextmanager
def held(run):
    """Another process that holds the run."""
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(run)], stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout.readline() == "held\n"
            yield process
        finally:
            process.kill()


def test_a_second_process_gets_one_line_and_exit_code_2(tmp_path, capsys):
    data, run = tmp_path / "data", tmp_path / "run"
    make_synthetic_dataset(data, n_views=2, n_timesteps=1, size=24, alphas=(), n_test=0)
    command = ["train", str(data), "--out", str(run), "--set", "space.iterations=5"]
    with held(run) as other:
        assert main(command) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert f"{run} is in use: another process trains it" in error
        assert [p.name for p in run.iterdir()] == [".lock"]
        other.kill()
        other.wait()
        assert main(command) == 0, capsys.readouterr().err  # what a killed one left blocks nobody
    assert {p.name for p in run.iterdir()} == {"config.json", "log.json", "space.safetensors"}
