"""The zip that users install: its content, its version, and that Blender takes it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tg4mm import __version__
from tg4mm.splatfile import positions_at, read_splat

pytest.importorskip("bpy", reason="needs pip's Blender: pip install 'tg4mm[generate]'")

CONTENT = {
    "blender_manifest.toml",
    "LICENSE",
    *(f"{name}.py" for name in ("__init__", "compat", "nodes", "operators", "panel", "scene")),
    *(f"core/{name}.py" for name in ("__init__", "errors")),
    *(
        f"core/splatfile/{n}.py"
        for n in ("__init__", "formula", "header", "layout", "model", "read", "write")
    ),
}

IN_BLENDER = """
import json, sys, bpy
zip_path, splat_path = sys.argv[1:]
bpy.ops.extensions.package_install_files(filepath=zip_path, repo="user_default", enable_on_install=True)
import bl_ext.user_default.tg4mm as extension
bpy.ops.import_scene.tg4mm_splat(filepath=splat_path)
obj = bpy.context.object
modifier = extension.scene.splat_modifier(obj)
extension.compat.set_input(modifier, extension.nodes.ALPHA, 3.0)
extension.compat.set_input(modifier, extension.nodes.MIN_OPACITY, 0.0)
bpy.context.scene.frame_set(5)
depsgraph = bpy.context.evaluated_depsgraph_get()
places = [list(i.matrix_world.translation) for i in depsgraph.object_instances if i.is_instance]
heavy = sorted({"torch", "PIL", "plyfile", "scipy", "tg4mm"} & set(sys.modules))
print("RESULT", json.dumps({"places": places, "heavy": heavy}))
"""


@pytest.fixture(scope="module")
def zip_path(make_extension: ModuleType, staged: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_extension.build(staged, tmp_path_factory.mktemp("dist"))


def test_zip_holds_the_package_and_nothing_else(zip_path: Path) -> None:
    with zipfile.ZipFile(zip_path) as archive:
        assert set(archive.namelist()) == CONTENT


def test_versions_agree(repo_root: Path, zip_path: Path) -> None:
    project = tomllib.loads((repo_root / "pyproject.toml").read_text())["project"]
    manifest = tomllib.loads((repo_root / "blender_manifest.toml").read_text())
    assert manifest["version"] == project["version"] == __version__
    assert zip_path.name == f"tg4mm-{__version__}.zip"
    assert manifest["license"] == [f"SPDX:{project['license']}"]


def test_permission_texts_are_as_blender_wants_them(repo_root: Path) -> None:
    manifest = tomllib.loads((repo_root / "blender_manifest.toml").read_text())
    for text in (manifest["tagline"], *manifest["permissions"].values()):
        assert len(text) <= 64
        assert text[-1].isalnum()


def test_builder_refuses_a_broken_package(make_extension: ModuleType, staged: Path, tmp_path: Path) -> None:
    broken = make_extension.stage(tmp_path / "broken")
    manifest = broken / "blender_manifest.toml"
    manifest.write_text(manifest.read_text().replace('type = "add-on"', 'type = "addon"'))
    with pytest.raises(RuntimeError, match="blender_ext build failed"):
        make_extension.build(broken, tmp_path / "dist")


def test_blender_installs_the_zip_and_plays_a_splat(zip_path: Path, splat_path: Path, tmp_path: Path) -> None:
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(tmp_path / "resources")}
    command = [sys.executable, "-c", IN_BLENDER, str(zip_path), str(splat_path)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    line = next(line for line in done.stdout.splitlines() if line.startswith("RESULT "))
    result = json.loads(line.removeprefix("RESULT "))
    assert result["heavy"] == []
    expected = positions_at(read_splat(splat_path), 4, 3.0)
    np.testing.assert_allclose(np.array(result["places"]), expected, atol=1e-3)
