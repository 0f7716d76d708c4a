"""The preferences' Test: what it says of a Python that can train, and of each way in which one cannot."""

import json
import os
import sys

import pytest

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

ALL = ("tg4mm", "torch", "numba", "safetensors", "bpy")


def answering(path, text):
    """A program that prints a text whatever it is asked."""
    path.write_text(f"#!/bin/sh\ncat <<'END'\n{text}\nEND\n")
    path.chmod(0o755)
    return str(path)


def report(tmp_path, there, version="0.1.0"):
    return answering(
        tmp_path / "python", json.dumps({"python": "3.11.7", "there": there, "version": version})
    )


def test_all_is_there(extension, tmp_path):
    check = extension.jobs.core_check.check
    python = report(tmp_path, dict.fromkeys(ALL, True))
    assert check(python, "0.1.0") == "tg4mm 0.1.0 on Python 3.11.7, ready to generate and to train"
    assert check(python, "0.2.0").endswith("; this extension is 0.2.0: install the same version of both")


@pytest.mark.parametrize("lost", ALL)
def test_what_is_missing_is_named(extension, tmp_path, lost):
    python = report(tmp_path, {name: name != lost for name in ALL})
    with pytest.raises(Exception, match=rf"Python 3.11.7 of .* has no {lost}; run this"):
        extension.jobs.core_check.check(python, "0.1.0")


def test_a_file_that_is_no_python_is_reported(extension, tmp_path):
    check = extension.jobs.core_check.check
    with pytest.raises(Exception, match="is not a Python interpreter: choose bin/python"):
        check(answering(tmp_path / "talker", "hello"), "0.1.0")
    (tmp_path / "text").write_text("nothing")
    with pytest.raises(Exception, match="cannot be started: Permission denied"):
        check(str(tmp_path / "text"), "0.1.0")


def test_a_real_python_answers(extension, monkeypatch, tmp_path):
    """An empty environment of this Python: it has nothing of what is needed."""
    import venv

    venv.create(tmp_path / "env", with_pip=False)
    python = tmp_path / "env" / "bin" / "python"
    if os.name == "nt" or not python.exists():
        pytest.skip("no environment can be made here")
    monkeypatch.delenv("PYTHONPATH", raising=False)
    monkeypatch.setattr(extension.preferences.TG4MM_defaults, "core_python", str(python))
    number = ".".join(map(str, sys.version_info[:3]))
    with pytest.raises(
        RuntimeError, match=rf"Python {number} of .* has no tg4mm, torch, numba, safetensors, bpy"
    ):
        bpy.ops.tg4mm.test_core()
    monkeypatch.setattr(extension.preferences.TG4MM_defaults, "core_python", "")
    with pytest.raises(RuntimeError, match="Python of the Core is empty"):
        bpy.ops.tg4mm.test_core()
