"""`--list`: what a user's file holds, before a motion is written; nothing is written."""

import subprocess
import sys

import pytest

bpy = pytest.importorskip("bpy")

from dataset_gen.errors import GenerateError  # noqa: E402
from dataset_gen.options import parser, request_from  # noqa: E402
from tests.dataset_gen.sources_blends import link, new_scene, save, tetrahedron  # noqa: E402


@pytest.fixture(scope="module")
def blend(tmp_path_factory):
    """A tetrahedron of 1 × 2 × 3 mm with a vertex group and an empty one."""
    scene = new_scene()
    scene.unit_settings.system, scene.unit_settings.length_unit = "METRIC", "MILLIMETERS"
    scene.unit_settings.scale_length = 0.001
    obj = link("tongue", tetrahedron())
    obj.vertex_groups.new(name="tip").add([1], 1.0, "REPLACE")
    obj.vertex_groups.new(name="nobody")
    return save(tmp_path_factory.mktemp("list"))


@pytest.fixture(scope="module")
def stl(blend):
    bpy.ops.wm.stl_export(filepath=str(blend.with_suffix(".stl")))
    return blend.with_suffix(".stl")


def listed(*arguments):
    command = [sys.executable, "-m", "dataset_gen", "--list", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True)


def test_parts_boxes_groups_and_scale(blend):
    done = listed("--blend", blend)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0] == "1 part, 4 vertices"
    assert lines[1] == "scale: 1 scene unit is 1 mm; metres are known"
    assert " ".join(lines[-1].split()) == "tongue 4 (0, 0, 0) (1, 2, 3) tip, nobody (empty)"


def test_a_mesh_says_how_it_was_scaled(stl):
    done = listed("--mesh", stl)
    assert done.returncode == 0, done.stderr
    scale = float(done.stdout.split("1 scene unit is ")[1].split()[0])
    assert f"units of {stl.name}; metres are not known" in done.stdout
    # the corners of its box are 1.2 scene units or less off the middle, √14 / 2 of the file's units at most
    assert 0.9 * 14**0.5 / 2 / 1.2 < scale <= 14**0.5 / 2 / 1.2 * 1.001


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["mic", "--list"], "--list needs --blend or --mesh, not the scene mic"),
        (["--list", "--out", "x"], "--out x: --list only reads the file, it writes nothing"),
        (["--list", "--alphas", "5"], "--alphas 5: --list only reads the file"),
        (["--list", "--save-blend", "b.blend"], "--save-blend b.blend: --list only reads the file"),
    ],
)
def test_options_that_would_be_ignored_are_refused(blend, arguments, message):
    source = [] if "mic" in arguments else ["--blend", str(blend)]
    with pytest.raises(GenerateError, match=message):
        request_from(parser().parse_args([*source, *arguments]))
