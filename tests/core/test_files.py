"""Atomic files: the target is the old content or the new one, never a part, and nothing is left behind."""

import os

import pytest
from filelock import FileLock, Timeout

from tg4mm.core.files import give_back, write_atomic, write_json


def test_failing_writer_leaves_the_old_file_and_no_temporary(tmp_path):
    target = tmp_path / "a.json"
    write_json(target, {"v": 1})

    def fail(temporary):
        temporary.write_text("half")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        write_atomic(target, fail)
    assert target.read_text() == '{\n  "v": 1\n}\n'
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_on_windows_a_file_that_is_open_elsewhere_is_waited_for(tmp_path, monkeypatch):
    """A virus scanner has what was just written open for some milliseconds."""
    calls, replace = [], os.replace

    def held(source, target):
        calls.append(target)
        if len(calls) < 3:
            raise PermissionError(13, "The process cannot access the file", str(target))
        replace(source, target)

    monkeypatch.setattr("tg4mm.core.temporary.os.replace", held)
    monkeypatch.setattr("tg4mm.core.temporary.WINDOWS", True)
    write_json(tmp_path / "a.json", 1)
    assert (tmp_path / "a.json").read_text() == "1\n"
    assert len(calls) == 3
    calls.clear()
    monkeypatch.setattr(
        "tg4mm.core.temporary.WINDOWS", False
    )  # elsewhere it is a fault, which is not waited for
    with pytest.raises(PermissionError):
        write_json(tmp_path / "a.json", 2)
    assert (tmp_path / "a.json").read_text() == "1\n"
    assert len(calls) == 1


def test_json_without_nan(tmp_path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "a.json", {"v": float("nan")})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("windows", [False, True])
def test_a_lock_given_back_is_free_and_leaves_no_file(tmp_path, monkeypatch, windows):
    monkeypatch.setattr("tg4mm.core.files.WINDOWS", windows)
    lock, other = FileLock(tmp_path / ".lock"), FileLock(tmp_path / ".lock")
    lock.acquire()
    with pytest.raises(Timeout):
        other.acquire(blocking=False)
    give_back(lock)
    assert not list(tmp_path.iterdir())
    other.acquire(blocking=False)
    other.release()
