"""Build the extension's zip: stage a folder that is the package, then run Blender's own builder on it.

Not part of the extension. The builder lies in the bpy wheel and runs without Blender. A staged folder is
needed since the package's parts lie in three places: the manifest at the root, addon/, and the reader of the
splat file in tg4mm/, which inside Blender is the sub-package `core`.
"""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def stage(folder: Path) -> Path:
    """Fill `folder` (made anew) with the extension as Blender loads it, and return it."""
    if folder.exists():
        shutil.rmtree(folder)
    folder.mkdir(parents=True)
    for name in ("blender_manifest.toml", "LICENSE"):
        shutil.copyfile(ROOT / name, folder / name)
    for file in sorted((ROOT / "addon").rglob("*.py")):
        target = folder / file.relative_to(ROOT / "addon")
        if file.name != Path(__file__).name:
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, target)
    core = folder / "core"
    (core / "splatfile").mkdir(parents=True)
    (core / "__init__.py").write_text('"""The parts of tg4mm that need numpy alone."""\n', encoding="utf-8")
    for source in (ROOT / "tg4mm" / "errors.py", *sorted((ROOT / "tg4mm" / "splatfile").glob("*.py"))):
        shutil.copyfile(source, core / source.relative_to(ROOT / "tg4mm"))
    return folder


def build(staged: Path, out: Path) -> Path:
    """Build and validate the zip from a staged folder; returns its path in the folder `out`."""
    manifest = tomllib.loads((staged / "blender_manifest.toml").read_text(encoding="utf-8"))
    out.mkdir(parents=True, exist_ok=True)
    target = out / f"{manifest['id']}-{manifest['version']}.zip"
    _blender_extension("build", "--source-dir", str(staged), "--output-filepath", str(target))
    _blender_extension("validate", str(target))
    return target


def builder() -> Path:
    """Blender's builder in the installed bpy. Raises FileNotFoundError without one."""
    spec = importlib.util.find_spec("bpy")  # finds, does not import
    folders = list(spec.submodule_search_locations or []) if spec is not None else []
    for folder in folders:
        for found in Path(folder).glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"):
            return found
    raise FileNotFoundError("Blender's extension builder is not there: pip install 'tg4mm[generate]'")


def _blender_extension(*arguments: str) -> None:
    done = subprocess.run([sys.executable, str(builder()), *arguments], capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"blender_ext {arguments[0]} failed: {done.stdout}{done.stderr}")


def main() -> None:
    """`python addon/make_extension.py`: build/extension/ staged, dist/tg4mm-<version>.zip built."""
    print(build(stage(ROOT / "build" / "extension"), ROOT / "dist"))


if __name__ == "__main__":
    main()
