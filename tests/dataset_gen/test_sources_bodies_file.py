"""The file that carries a scene's geometry to the process without Blender; that process stays without it."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from dataset_gen.errors import GenerateError
from dataset_gen.sources import bodies_file
from tests.helpers.bodies_file import FOUND


def test_what_is_read_is_what_was_written(tmp_path):
    bodies_file.save(tmp_path / "found.npz", FOUND)
    got = bodies_file.load(tmp_path / "found.npz")
    assert replace(got, bodies=()) == replace(FOUND, bodies=())
    assert len(got.bodies) == 2
    for body, wanted in zip(got.bodies, FOUND.bodies, strict=True):
        assert body.name == wanted.name
        assert np.array_equal(body.vertices, wanted.vertices)
        assert np.array_equal(body.triangles, wanted.triangles)
        assert np.array_equal(body.follow, wanted.follow)
        assert {k: v.tolist() for k, v in body.groups.items()} == {
            k: v.tolist() for k, v in wanted.groups.items()
        }
    assert os.listdir(tmp_path) == ["found.npz"]


def test_a_missing_a_foreign_and_a_truncated_file_are_one_line_each(tmp_path):
    with pytest.raises(GenerateError, match=r"absent\.npz cannot be read: No such file"):
        bodies_file.load(tmp_path / "absent.npz")
    np.savez(tmp_path / "foreign.npz", other=np.zeros(3))
    with pytest.raises(GenerateError, match="does not hold the geometry"):
        bodies_file.load(tmp_path / "foreign.npz")
    bodies_file.save(tmp_path / "found.npz", FOUND)
    whole = (tmp_path / "found.npz").read_bytes()
    (tmp_path / "found.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(GenerateError, match="does not hold the geometry"):
        bodies_file.load(tmp_path / "found.npz")


def test_reading_it_imports_no_blender():
    program = "import sys; sys.modules['bpy'] = None; from dataset_gen.sources import bodies_file"
    subprocess.run([sys.executable, "-c", program], check=True)
