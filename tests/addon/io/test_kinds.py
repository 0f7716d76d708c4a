"""The import takes every kind of splat file; what the format says of up is taken over once; what is odd is said."""

import re

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from tests.addon.conftest import some_splat  # noqa: E402
from tests.addon.playing import blocks, import_splat  # noqa: E402
from tests.helpers.splat_files import KINDS, sog_parts, sog_zip, write_as  # noqa: E402
from tg4mm.core.splatfile import read_splat, write_splat  # noqa: E402


def places(obj, n):
    """[n, 3] world places of the object's first points: it may have others, for its transform."""
    found = np.empty(3 * len(obj.data.vertices), np.float32)
    obj.data.vertices.foreach_get("co", found)
    matrix = np.array(obj.matrix_world)
    return found.reshape(-1, 3)[:n] @ matrix[:3, :3].T + matrix[:3, 3]


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_imported_with_z_up(extension, kind, tmp_path):
    pytest.importorskip("zstandard") if kind == "SPZ 4" else None
    pytest.importorskip("gsply") if kind == "compressed PLY" else None
    path = write_as(kind, tmp_path, some_splat(degree=1))
    obj = import_splat(path, sequence=False)
    bpy.context.view_layer.update()
    np.testing.assert_allclose(places(obj, 23), read_splat(path).means, atol=1e-5)


def test_cameras_beside_a_file_whose_format_says_what_is_up_are_not_asked(extension, tmp_path):
    (tmp_path / "cameras.json").write_text('[{"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}]')  # −Y up
    path = write_as("SPZ 3", tmp_path, some_splat())
    obj = import_splat(path)
    assert tuple(obj.rotation_euler) == (0, 0, 0)
    assert import_splat(write_as("PLY", tmp_path, some_splat())).rotation_euler.x != 0


def test_blender_decodes_what_pillow_does_and_says_what_it_cannot(extension, tmp_path):
    meta, pictures = sog_parts(some_splat())
    before = blocks()
    for data in pictures.values():
        from io import BytesIO

        from PIL import Image

        want = np.asarray(Image.open(BytesIO(data)).convert("RGBA"))
        np.testing.assert_array_equal(extension.nodes.blending.decode(data), want)
    assert blocks() == before
    data = pictures["quats.webp"]
    damaged = data[:4] + (len(data) - 28).to_bytes(4, "little") + data[8:-20]
    sog_zip(tmp_path / "a.sog", meta, pictures | {"quats.webp": damaged})
    with pytest.raises(RuntimeError, match=r"a\.sog: quats\.webp is damaged: Blender cannot read it"):
        bpy.ops.import_scene.tg4mm_splat(filepath=str(tmp_path / "a.sog"))
    assert blocks() == before


def test_frequencies_that_were_lost_are_asked_for(extension, tmp_path):
    path = tmp_path / "a.ply"
    write_splat(path, some_splat())
    path.write_bytes(re.sub(rb"comment tg4mm .*\n", b"", path.read_bytes()))
    assert not extension.nodes.scene.moves(import_splat(path))
    assert extension.nodes.scene.moves(import_splat(path, frequencies="3, 5, 7.5"))
    for text, message in (
        ("3, five", "'five' is not a frequency; expected numbers of at least 0 in Hz"),
        ("3", "1 frequencies were given"),
    ):
        with pytest.raises(RuntimeError, match=message):
            bpy.ops.import_scene.tg4mm_splat(filepath=str(path), frequencies=text)
