"""What cannot be imported is reported in one line, and nothing of it stays behind."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tg4mm.core.splatfile import read_splat

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from tests.addon.playing import blocks, import_files, import_splat  # noqa: E402


def refused(path: Path, message: str, **options: Any) -> None:
    """The import must report `message` and leave nothing."""
    before = blocks()
    with pytest.raises(RuntimeError, match=message):
        bpy.ops.import_scene.tg4mm_splat(filepath=str(path), **options)
    assert blocks() == before


def test_truncated_file(extension: ModuleType, splat_path: Path) -> None:
    splat_path.write_bytes(splat_path.read_bytes()[:-9])
    refused(splat_path, r"bell\.ply: is truncated")


def test_file_that_is_not_there(extension: ModuleType, splat_path: Path) -> None:
    refused(splat_path.with_name("nothing.ply"), r"nothing\.ply: cannot be read")


def test_foreign_files(extension: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "picture.ply").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(99))
    refused(tmp_path / "picture.ply", r"picture\.ply: is not a PLY")
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\nend_header\n"
    (tmp_path / "mesh.ply").write_bytes(head.encode() + bytes(4))
    refused(tmp_path / "mesh.ply", r"mesh\.ply: property y is missing")


def test_file_with_too_many_gaussians(extension: ModuleType, splat_path: Path) -> None:
    refused(splat_path, r"bell\.ply: holds 23 Gaussians, more than Most Gaussians, 22", most=22)
    assert import_splat(splat_path, most=23)


def test_one_bad_file_of_several_stops_all(extension: ModuleType, splat_path: Path) -> None:
    bad = splat_path.with_name("bad.ply")
    bad.write_bytes(splat_path.read_bytes()[:-1])
    before = blocks()
    with pytest.raises(RuntimeError, match=r"bad\.ply: is truncated"):
        import_files([splat_path, bad])
    assert blocks() == before


def test_fault_half_way_leaves_nothing(
    extension: ModuleType, splat_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = blocks()

    def fail(*_: Any) -> None:
        raise MemoryError("no room for the links")

    monkeypatch.setattr(extension.nodes.player, "build_shapes", fail)
    with pytest.raises(MemoryError):
        extension.nodes.scene.make_objects([read_splat(splat_path)], ["bell"], bpy.context.collection)
    assert blocks() == before
    with pytest.raises(RuntimeError, match=r"bell\.ply: not enough memory"):
        bpy.ops.import_scene.tg4mm_splat(filepath=str(splat_path))
    assert blocks() == before
