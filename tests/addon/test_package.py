"""The zip that users install: its content, its version, and that Blender takes it."""

import importlib.util
import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path
from textwrap import indent

import numpy as np
import pytest

from tests.addon.conftest import some_splat
from tg4mm import __version__
from tg4mm.core.splatfile import positions_at, read_splat, write_splat

pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

# Each script prints a line RESULT {json}. play() reads where the object's instances are at two frames.
PLAY = """
import json, sys, bpy
def play():
    places = []
    for frame, subframe in ((5, 0.0), (7, 0.5)):
        bpy.context.scene.frame_set(frame, subframe=subframe)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        places.append([list(i.matrix_world.translation) for i in depsgraph.object_instances if i.is_instance])
    return places
"""
INSTALL = (
    PLAY
    + """
zip_path, splat_path, blend_path = sys.argv[1:]
bpy.ops.extensions.package_install_files(filepath=zip_path, repo="user_default", enable_on_install=True)
known = lambda: "tg4mm_splat" in dir(bpy.ops.import_scene)
states = [known()]
import addon_utils
for switch in (addon_utils.disable, addon_utils.enable):
    switch("bl_ext.user_default.tg4mm")
    states.append(known())
import bl_ext.user_default.tg4mm as extension
bpy.ops.import_scene.tg4mm_splat(filepath=splat_path)
modifier = extension.nodes.scene.splat_modifier(bpy.context.object)
compat, names = extension.compat, extension.names
compat.set_input(modifier, names.DRAW, "Ellipsoids")
compat.set_input(modifier, names.MIN_OPACITY, 0.0)
for frame, alpha in ((1, 3.0), (6, 3.0), (7, 8.0), (8, 8.0)):
    compat.set_input(modifier, names.ALPHA, alpha)
    bpy.context.object.keyframe_insert(compat.input_path(modifier, names.ALPHA), frame=frame)
bpy.ops.wm.save_as_mainfile(filepath=blend_path)
import dataset_gen, tg4mm
heavy = sorted({"torch", "PIL", "plyfile", "scipy"} & set(sys.modules))
carried = [dataset_gen.__file__, tg4mm.__file__, str(extension.jobs.commands.GENERATOR)]
print("RESULT", json.dumps({"places": play(), "heavy": heavy, "states": states, "carried": carried}))
"""
)
REOPEN = (
    PLAY
    + """
(blend_path,) = sys.argv[1:]
bpy.ops.wm.open_mainfile(filepath=blend_path)
present = "tg4mm_splat" in dir(bpy.ops.import_scene)
print("RESULT", json.dumps({"places": play(), "present": present}))
"""
)

PREFERENCES = """
import json, sys, bpy
zip_path, splat_path, still_path = sys.argv[1:]
bpy.ops.extensions.package_install_files(filepath=zip_path, repo="user_default", enable_on_install=True)
import bl_ext.user_default.tg4mm as extension
compat, names, scene = extension.compat, extension.names, extension.nodes.scene
own = extension.preferences.get(bpy.context)
found = {"own": type(own).__name__, "defaults": {}}
for name in ("draw_as", "band_width", "most", "length_unit", "digits", "core_python"):
    found["defaults"][name] = [getattr(own, name), getattr(extension.preferences.TG4MM_defaults, name)]
described = {p.identifier for p in own.bl_rna.properties if p.description}
found["undescribed"] = sorted(set(found["defaults"]) - described)
own.draw_as, own.band_width, own.length_unit, own.digits = "Arrows", 3.0, "SCENE", 2
own.core_python = "/usr/bin/python3"
bpy.ops.import_scene.tg4mm_splat(filepath=still_path)
still = bpy.context.object
bpy.ops.import_scene.tg4mm_splat(filepath=splat_path)
obj = bpy.context.object
found["drawn"] = [compat.get_input(scene.splat_modifier(o), names.DRAW) for o in (still, obj)]
found["best"] = extension.nodes.drawing.best(5, 0)
bpy.ops.tg4mm.band(frequency=5.0)
found["band"] = extension.panels.analysis.band(obj)
obj[names.UNIT_SCALE] = 0.1
found["length"] = extension.preferences.unit_for(bpy.context, obj).text(0.01234)
own.length_unit = "METRIC"
found["metric"] = extension.preferences.unit_for(bpy.context, obj).text(0.01234)
print("RESULT", json.dumps(found))
"""


def in_blender(script, resources, *arguments):
    """Run a script in a Blender of its own, whose user folder is `resources`; what it printed as RESULT."""
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(resources), "PYTHONPATH": ""}
    # A fault in pip's Blender can hang the interpreter's exit, so scripts leave without it. What this environment has
    # of tg4mm itself is out of the way.
    body = indent(script, "    ")
    leave = "finally:\n    sys.stdout.flush()\n    os._exit(0)"
    apart = (
        "sys.meta_path[:] = [f for f in sys.meta_path if 'editable' not in getattr(f, '__module__', '')]\n"
    )
    apart += "sys.path[:] = [p for p in sys.path if not os.path.isdir(os.path.join(p or '.', 'tg4mm'))]\n"
    code = f"import os, sys, traceback\n{apart}try:\n{body}\nexcept BaseException:\n    traceback.print_exc()\n{leave}"
    command = [sys.executable, "-c", code, *map(str, arguments)]
    done = subprocess.run(
        command, capture_output=True, text=True, env=environment, cwd=resources.parent, timeout=240
    )
    lines = [line for line in done.stdout.splitlines() if line.startswith("RESULT ")]
    assert lines, done.stdout + done.stderr
    return json.loads(lines[0].removeprefix("RESULT "))


@pytest.fixture(scope="session")
def make_extension(repo_root):
    """addon/make_extension.py, imported without the package around it."""
    spec = importlib.util.spec_from_file_location("make_extension", repo_root / "addon" / "make_extension.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def staged(make_extension, tmp_path_factory):
    """The folder that becomes the zip."""
    return make_extension.stage(tmp_path_factory.mktemp("stage") / "tg4mm")


@pytest.fixture(scope="module")
def zip_path(make_extension, staged, tmp_path_factory):
    return make_extension.build(staged, tmp_path_factory.mktemp("dist"))


def test_zip_holds_the_addon_and_a_wheel_of_the_repositorys_own_files(
    make_extension, repo_root, zip_path, tmp_path
):
    with zipfile.ZipFile(zip_path) as archive:
        wheel = f"wheels/tg4mm_core-{__version__}-py3-none-any.whl"
        ours = {
            file.relative_to(repo_root / "addon").as_posix() for file in (repo_root / "addon").rglob("*.py")
        }
        assert set(archive.namelist()) == {"blender_manifest.toml", "LICENSE", wheel} | ours - {
            "make_extension.py"
        }
        path = Path(archive.extract(wheel, tmp_path))
    with zipfile.ZipFile(path) as archive:
        rows = [line.split(",") for line in archive.read(archive.namelist()[-1]).decode().splitlines()]
        assert sorted(archive.namelist()) == sorted(row[0] for row in rows)
        names = [name for name in archive.namelist() if ".dist-info/" not in name]
        for name in names:
            assert archive.read(name) == (repo_root / name).read_bytes()
    held = {name.rpartition("/")[0] for name in names}
    assert {"tg4mm", "tg4mm/core", "tg4mm/core/splatfile", "dataset_gen", "dataset_gen/vibration"} <= held
    assert not {"tg4mm/core/pages", "dataset_gen/farm", "tg4mm/fit"} & held


def validated(zip_path):
    """Blender's own validator, which lies in pip's Blender and runs without it."""
    spec = importlib.util.find_spec("bpy")
    places = [Path(place) for place in spec.submodule_search_locations or ()]
    (tool,) = (t for p in places for t in p.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))
    command = [sys.executable, str(tool), "validate", str(zip_path)]
    return subprocess.run(command, capture_output=True, text=True)


def test_blender_takes_the_zip_and_refuses_a_broken_one(make_extension, zip_path, tmp_path):
    done = validated(zip_path)
    assert done.returncode == 0, done.stdout + done.stderr
    broken = make_extension.stage(tmp_path / "broken")
    manifest = broken / "blender_manifest.toml"
    manifest.write_text(manifest.read_text().replace('type = "add-on"', 'type = "addon"'))
    assert validated(make_extension.build(broken, tmp_path / "dist")).returncode != 0


def test_the_zip_needs_python_alone_and_is_the_same_each_time(repo_root, zip_path, tmp_path):
    code = (
        "import sys, pathlib\nsys.path.insert(0, 'addon')\n"
        "import make_extension as m\nout = pathlib.Path(sys.argv[1])\n"
        "print(m.build(m.stage(out / 'staged'), out))"
    )
    command = [sys.executable, "-I", "-S", "-c", code, str(tmp_path)]  # -S: nothing that was installed
    done = subprocess.run(command, capture_output=True, text=True, cwd=repo_root)
    assert done.returncode == 0, done.stderr
    assert Path(done.stdout.strip()).read_bytes() == zip_path.read_bytes()


def test_installed_from_the_zip_it_plays_and_its_blend_files_play_without_it(zip_path, splat_path, tmp_path):
    blend = tmp_path / "bell.blend"
    installed = in_blender(INSTALL, tmp_path / "resources", zip_path, splat_path, blend)
    assert installed["heavy"] == []
    assert all(name.startswith(str(tmp_path / "resources")) for name in installed["carried"])
    assert Path(installed["carried"][-1]).is_file()
    assert installed["states"] == [True, False, True]
    splat = read_splat(splat_path)
    np.testing.assert_allclose(np.array(installed["places"][0]), positions_at(splat, 4 / 3, 3.0), atol=1e-3)
    np.testing.assert_allclose(np.array(installed["places"][1]), positions_at(splat, 6.5 / 3, 8.0), atol=1e-3)

    without = in_blender(REOPEN, tmp_path / "other", blend)
    assert without["present"] is False
    np.testing.assert_allclose(np.array(without["places"]), np.array(installed["places"]), atol=1e-6)


def test_preferences_are_there_once_installed_and_are_followed(zip_path, splat_path, tmp_path):
    write_splat(tmp_path / "still.ply", some_splat(5, (), degree=0))
    found = in_blender(PREFERENCES, tmp_path / "resources", zip_path, splat_path, tmp_path / "still.ply")
    assert found["own"] == "TG4MM_preferences"
    for name, (own, fallback) in found["defaults"].items():
        assert own == fallback, name
    assert found["undescribed"] == []
    assert found["drawn"] == [found["best"], "Arrows"]  # what does not move has no arrows
    assert found["best"] in ("Native", "Splats")
    assert found["band"] == pytest.approx([3.5, 6.5])
    assert (found["length"], found["metric"]) == ("0.012 scene units", "1.2 mm")
