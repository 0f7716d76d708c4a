"""What cannot be imported is reported in one line, and nothing of it stays behind."""

import pytest

from tg4mm.core.splatfile import read_splat

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from tests.addon.playing import blocks, import_files, import_splat  # noqa: E402

MESH = b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\nend_header\n"


@pytest.mark.parametrize(
    ("change", "message", "most"),
    [
        (lambda data: data[:-9], "is truncated", 99),
        (lambda data: None, "cannot be read", 99),
        (lambda data: b"\x89PNG\r\n\x1a\n" + bytes(99), "is not a PLY", 99),
        (lambda data: MESH + bytes(4), "property y is missing", 99),
        (lambda data: data, "holds 23 Gaussians, more than the limit Max Gaussians, 22", 22),
    ],
)
def test_a_file_that_cannot_be_imported_leaves_nothing(extension, splat_path, change, message, most):
    before, data, bad = blocks(), splat_path.read_bytes(), splat_path.with_name("bad.ply")
    if change(data) is not None:
        bad.write_bytes(change(data))
    with pytest.raises(RuntimeError, match=rf"bad\.ply: {message}"):
        bpy.ops.import_scene.tg4mm_splat(filepath=str(bad), most=most)
    if most == 99:  # one of several stops all
        with pytest.raises(RuntimeError, match=rf"bad\.ply: {message}"):
            import_files([splat_path, bad])
    assert blocks() == before
    assert import_splat(splat_path, most=23)


def test_fault_half_way_leaves_nothing(extension, splat_path, monkeypatch):
    before = blocks()

    def fail(*_):
        raise MemoryError("no room for the links")

    monkeypatch.setattr(extension.nodes.player, "build_shapes", fail)
    with pytest.raises(MemoryError):
        extension.nodes.scene.make_objects([read_splat(splat_path)], ["bell"], bpy.context.collection)
    assert blocks() == before
    with pytest.raises(RuntimeError, match=r"bell\.ply: not enough memory"):
        bpy.ops.import_scene.tg4mm_splat(filepath=str(splat_path))
    assert blocks() == before
