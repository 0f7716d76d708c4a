"""Every reader takes 150 mutations of its files ($TG4MM_MUTATIONS: another number) without a fault."""

import os
import signal
import time

import numpy as np
import pytest

from tests.faults import harness
from tests.faults.harness import run_reader
from tests.faults.mutate import of_bytes
from tests.faults.readers import READERS, Reader
from tg4mm.core.errors import CaptureError

COUNT = int(os.environ.get("TG4MM_MUTATIONS", "150"))


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_mutated_files_are_refused_in_one_line_or_read(name):
    tally = run_reader(name, COUNT, seed=0)
    assert tally.count == COUNT
    assert not tally.faults, "\n".join(f"{index}: {what}" for index, what in tally.faults[:10])


def make(root):
    (root / "a").write_bytes(b"0123456789")
    (root / "c").write_bytes(b"A")
    return root / "a"


def spoilt(root):
    return (root / "a").read_bytes() != b"0123456789"


def foreign(root):
    raise KeyError("no such thing")


def dies(root):
    os.kill(os.getpid(), signal.SIGKILL)


def hangs(root):
    time.sleep(60)


def hoards(root):
    np.ones(4 << 27)  # 4 GiB


def writes(root):
    (root / "b").touch()


def changes(root):
    (root / "c").write_bytes(b"B")


def good(root):
    raise CaptureError("spoilt")


FAULTS = {
    foreign: "KeyError", dies: "the process died", hangs: "no answer within 1 s",
    hoards: "MemoryError", writes: "something beside the file", changes: "something beside the file",
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_each_kind_of_fault_is_reported(fault, monkeypatch):
    monkeypatch.setattr(harness, "LIMIT_S", 1.0)
    monkeypatch.setattr(harness, "FIRST_S", 1.0)
    reader = Reader(make, lambda root: fault(root) if spoilt(root) else None, lambda data, rng: data + b"x")
    monkeypatch.setitem(READERS, "wrong", reader)
    tally = harness.run_reader("wrong", 2, 0)
    assert [index for index, _ in tally.faults] == [0, 1]
    assert all(FAULTS[fault] in what for _, what in tally.faults), tally.faults


def test_a_refusal_in_one_line_is_no_fault(monkeypatch):
    monkeypatch.setitem(READERS, "right", Reader(make, lambda r: good(r) if spoilt(r) else None, of_bytes))
    tally = harness.run_reader("right", 50, 0)
    assert (tally.count, tally.faults) == (50, [])
    assert tally.refused > 40
