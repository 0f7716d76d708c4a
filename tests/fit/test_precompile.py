"""Kernels compiled in advance: the jobs compile what the program calls, and a command waits for them and no longer."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tg4mm.fit import precompile
from tg4mm.fit.kernel_calls import JOBS
from tg4mm.fit.rasterize import missing

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_every_job_compiles_each_kernel_that_it_names(tmp_path):
    """One more signature each. With an empty cache: what is loaded from one does not load the kernels inside it."""
    code = """
from tests.helpers.kernels import kernels_of
from tg4mm.fit.kernel_calls import JOBS
count = lambda: [len(kernel.signatures) for kernel in kernels_of(job)]
for name, job in JOBS.items():
    before = count()
    job.call()
    print(name, [after > number for number, after in zip(before, count())], sep=";")
"""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [f"{name};{[True] * len(job.kernels)}" for name, job in JOBS.items()]


@pytest.mark.slow
def test_training_asks_for_no_other_types():
    """An iteration as the space stage does it, in a process that the jobs ran in before: not one more signature."""
    code = """
import numpy as np, torch
from tests.helpers.kernels import kernels_of
from tg4mm.fit.kernel_calls import JOBS
from tg4mm.fit.space.fused import FusedAdam, Iteration
jobs = [job for job in JOBS.values() if job.group != "motion"]
for job in jobs:
    job.call()
before = [len(k.signatures) for job in jobs for k in kernels_of(job)]
n = 20
shapes = {"means": (n, 3), "quats": (n, 4), "log_scales": (n, 3), "logits": (n,), "sh0": (n, 1, 3), "shn": (n, 15, 3)}
adam = FusedAdam({k: torch.rand(s) for k, s in shapes.items()}, 1.0)
view, K = np.eye(4, dtype=np.float32), np.array([[20, 0, 8], [0, 20, 8], [0, 0, 1]], np.float32)
view[2, 3] = 3
Iteration(10.0, 0.0)(adam, view, K, np.ones((16, 16, 3), np.float32), 3, 0.5, np.zeros(n, np.float32))
print(before == [len(k.signatures) for job in jobs for k in kernels_of(job)])
"""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=ROOT, capture_output=True, text=True
    )
    assert done.stdout.strip() == "True", done.stderr


def test_where_no_process_starts_the_command_goes_on(monkeypatch, capsys):
    jobs = precompile._Jobs()
    monkeypatch.setattr(precompile.sys, "executable", "/nowhere/python")
    assert not jobs.wait("blend._forward")
    assert "compiling kernels" in capsys.readouterr().err


def test_a_kernel_is_there_after_the_wait_which_counts(monkeypatch, capsys):
    jobs = precompile._Jobs()
    monkeypatch.setattr(
        precompile, "_WORK", "import sys\nfor line in sys.stdin: print(line.strip(), flush=True)"
    )
    assert jobs.wait("blend._forward")
    assert "(pictures): 3/3 steps" in capsys.readouterr().err
    assert not jobs.wait("blend._forward")  # it was made, for other types: not again


def test_only_once_enabled_is_a_kernel_waited_for(monkeypatch):
    monkeypatch.setattr(missing, "_answers", [])  # a test that ran the program may have enabled it
    assert not missing.may_be_there("blend._forward")
    monkeypatch.setattr(precompile._jobs, "wait", lambda kernel: kernel == "blend._forward")
    monkeypatch.setattr(precompile.os, "cpu_count", lambda: 2)
    precompile.enable()
    assert missing.may_be_there("blend._forward")
    assert not missing.may_be_there("elsewhere.unknown")
