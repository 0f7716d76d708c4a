"""Atomic files: the target is the old content or the new one, never a part, and nothing is left behind."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from filelock import FileLock, Timeout

from dataset_gen.tree import whole
from tg4mm.core import files
from tg4mm.core.files import give_back, is_temporary, remove_leftovers, write_atomic, write_json
from tg4mm.core.splatfile.ply import replacing

KILLED = """
import os, signal, sys
from pathlib import Path
from tg4mm.core.files import write_atomic
from tg4mm.core.splatfile.ply import replacing
from dataset_gen.tree import whole
def half(temporary):
    temporary.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
path = Path(sys.argv[2])
if sys.argv[1] == "write_atomic":
    write_atomic(path, half)
with {"replacing": replacing, "whole": whole}[sys.argv[1]](path) as temporary:
    half(temporary)
"""


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

    monkeypatch.setattr("tg4mm.core.files.os.replace", held)
    monkeypatch.setattr("tg4mm.core.files.WINDOWS", True)
    write_json(tmp_path / "a.json", 1)
    assert (tmp_path / "a.json").read_text() == "1\n"
    assert len(calls) == 3
    calls.clear()
    monkeypatch.setattr("tg4mm.core.files.WINDOWS", False)  # elsewhere it is a fault, which is not waited for
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


def killed(writer, path):
    """Names in the folder after a process was killed while it wrote."""
    subprocess.run([sys.executable, "-c", KILLED, writer, str(path)], check=False)
    return os.listdir(path.parent)


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize("writer", ["write_atomic", "replacing", "whole"])
def test_the_next_writer_of_a_folder_removes_what_a_killed_one_left(writer, tmp_path):
    (left,) = killed(writer, tmp_path / "r_000.ply")
    assert is_temporary(Path(left), "r_000.ply")
    write_json(tmp_path / "other.json", 1)
    assert os.listdir(tmp_path) == ["other.json"]
    (tmp_path / "sub").mkdir()
    killed(writer, tmp_path / "sub" / "r_000.ply")
    remove_leftovers(tmp_path)
    assert not os.listdir(tmp_path / "sub")


def test_what_another_process_is_writing_stays(tmp_path):
    living = files.temporary_name(tmp_path / "a.json").with_name(f".a.json.{files._HOST}-{os.getppid()}.tmp")
    elsewhere = tmp_path / ".a.json.node7-1.tmp"
    own, foreign = files.temporary_name(tmp_path / "a.json"), tmp_path / ".vimrc.tmp"
    for path in (living, elsewhere, own, foreign):
        path.touch()
    remove_leftovers(tmp_path)
    assert len(os.listdir(tmp_path)) == 4


def test_from_another_machine_an_hour_without_a_change_tells(tmp_path, monkeypatch):
    for name in (".a.json.node7-1.tmp", ".a.0123456789ab.tmp.png", ".vimrc.tmp"):
        (tmp_path / name).touch()
    later = time.time() + 4000
    monkeypatch.setattr("tg4mm.core.files.time.time", lambda: later)
    remove_leftovers(tmp_path)
    assert os.listdir(tmp_path) == [".vimrc.tmp"]


@pytest.mark.parametrize("writer", ["write_atomic", "replacing", "whole"])
def test_what_is_written_is_on_disk_before_it_has_its_name(writer, tmp_path, monkeypatch):
    done: list[tuple[str, int]] = []
    sync, replace = os.fsync, os.replace

    def fsync(file):
        done.append(("on disk", os.fstat(file).st_ino))
        sync(file)

    def named(source, target):
        done.append(("named", os.stat(source).st_ino))
        replace(source, target)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "replace", named)
    if writer == "write_atomic":
        write_atomic(tmp_path / "a", lambda temporary: temporary.write_bytes(b"1"))
    else:
        with {"replacing": replacing, "whole": whole}[writer](tmp_path / "a") as temporary:
            temporary.write_bytes(b"1")
    inode = os.stat(tmp_path / "a").st_ino
    assert done == [("on disk", inode), ("named", inode)]
