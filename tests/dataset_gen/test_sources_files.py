"""The files around a scene: the header of a user's .blend, and the file that carries geometry to other processes."""

import gzip
import os
from dataclasses import replace

import numpy as np
import pytest

from dataset_gen.errors import GenerateError
from dataset_gen.sources import bodies_file
from tests.helpers.bodies_file import FOUND

OLD = b"BLENDER-v405" + b"DATA" * 100 + b"ENDB" + bytes(20)
NEW = b"BLENDER17-01v0502" + b"DATA" * 100 + b"ENDB" + bytes(28)


def write(tmp_path, content):
    path = tmp_path / "user.blend"
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"", "is empty"),
        (b"# a text\n" * 10, r"is not a \.blend file: it begins with b'# a text'"),
        (gzip.compress(b"no scene in here", mtime=0), r"is not a \.blend file: it begins with b'no scene'"),
        (OLD[:200], "is truncated: the block that closes"),
        (NEW[:300], "is truncated"),
        (gzip.compress(OLD, mtime=0)[:-20], "is truncated or damaged"),
        (gzip.compress(OLD[:200], mtime=0), "is truncated"),
    ],
)
def test_other_files_are_refused_in_one_line_with_the_path(tmp_path, content, complaint):
    with pytest.raises(GenerateError, match=rf"user\.blend {complaint}") as caught:
        bodies_file.check(write(tmp_path, content), (5, 2))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [NEW, gzip.compress(NEW, mtime=0)])
def test_a_file_of_a_newer_blender_is_refused_with_both_versions(tmp_path, content):
    with pytest.raises(GenerateError, match=r"saved by Blender 5\.2, newer than this Blender 4\.5"):
        bodies_file.check(write(tmp_path, content), (4, 5))


def test_what_blender_saves_passes_and_its_pieces_do_not(tmp_path):
    pytest.importorskip("bpy")
    from dataset_gen.sources import open_blend
    from tests.dataset_gen.sources_blends import link, new_scene, save, tetrahedron

    new_scene()
    link("part", tetrahedron())
    for name, options in (("plain.blend", {"compress": False}), ("small.blend", {"compress": True})):
        path = save(tmp_path, name, **options)
        assert [body.name for body in open_blend(path).bodies] == ["part"]
        whole = path.read_bytes()
        for share in (0.3, 0.6, 0.99):
            path.write_bytes(whole[: int(share * len(whole))])
            with pytest.raises(GenerateError, match=name.replace(".", r"\.")) as caught:
                open_blend(path)
            assert "\n" not in str(caught.value)
        path.write_bytes(gzip.compress(whole, mtime=0) if name == "plain.blend" else whole)
        assert [body.name for body in open_blend(path).bodies] == ["part"]


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
        groups, expected = ({k: v.tolist() for k, v in own.groups.items()} for own in (body, wanted))
        assert groups == expected
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
