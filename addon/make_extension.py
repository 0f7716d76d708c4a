"""Build the extension's zip, by Python's own library alone: stage a folder that is the package, then pack it.

Not part of the extension. A staged folder is needed since the package's parts lie in several places: the manifest at
the root, addon/, the reader of the splat file in tg4mm/, which inside Blender is the sub-package `core`, and the
generator, which is `generator`. A test has Blender's own validator look at the zip.
"""

from __future__ import annotations

import shutil
import tomllib
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
_DATE = (1980, 1, 1, 0, 0, 0)  # of every file in the zip
# The imports with which dataset_gen.vibration leaves its package, and how they read inside the extension.
_LEAVING = {
    "errors.py": ("..", "from tg4mm.core.errors import Tg4mmError\n"),
    "limits.py": ("..", "from tg4mm.core.values import Number\n"),
    "vibration/values.py": ("...", "from tg4mm.core.values import Number\n"),
    "vibration/describe.py": ("...", "from tg4mm.core.untrusted import read_json, read_yaml\n"),
}


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
    alone = [
        ROOT / "tg4mm" / "core" / name for name in ("errors.py", "temporary.py", "untrusted.py", "values.py")
    ]
    for source in (*alone, *sorted((ROOT / "tg4mm" / "core" / "splatfile").glob("*.py"))):
        shutil.copyfile(source, core / source.relative_to(ROOT / "tg4mm" / "core"))
    shutil.copyfile(ROOT / "tg4mm" / "core" / "colour.py", core / "colour.py")
    stage_generator(folder / "generator")
    return folder


def stage_generator(folder: Path) -> None:
    """Fill `folder` with dataset_gen, and with what it needs of tg4mm.

    A background process has the folder on its path and finds both there. Blender itself, which must not be given
    names for all extensions to see, imports dataset_gen.vibration as a part of the extension, relatively.
    """
    folder.mkdir()
    text = '"""The dataset generator: run by background processes; its fields are the preview\'s."""\n'
    (folder / "__init__.py").write_text(text, encoding="utf-8")
    for source in generator_files():
        target = folder / source.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)
    for name, (dots, absolute) in _LEAVING.items():
        _either(folder / "dataset_gen" / name, absolute, absolute.replace("tg4mm", f"{dots}tg4mm", 1))


def _either(file: Path, absolute: str, relative: str) -> None:
    """Let a module import relatively where it is a part of the extension."""
    text = file.read_text(encoding="utf-8")
    if text.count(absolute) != 1:
        raise RuntimeError(f"{file} should hold the line {absolute!r} once")
    within = 'if not __package__.startswith("dataset_gen"):  # inside the extension'
    both = f"{within}\n    {relative}else:\n    {absolute}"
    file.write_text(text.replace(absolute, both), encoding="utf-8")


# What dataset_gen imports of tg4mm; nothing in these needs more than Python, numpy and PyYAML.
_GENERATOR_NEEDS = (
    "__init__.py",
    "core/__init__.py",
    "core/errors.py",
    "core/events.py",
    "core/files.py",
    "core/records.py",
    "core/values.py",
    "core/lazy.py",
    "core/work_folder.py",
    "core/progress.py",
    "core/temporary.py",
    "core/untrusted.py",
)


def generator_files() -> list[Path]:
    """What the generator consists of, for Blender: not what spreads work over a cluster."""
    package = ROOT / "dataset_gen"
    found = [file for kind in ("*.py", "*.yaml") for file in package.rglob(kind)]
    kept = [file for file in found if "farm" not in file.relative_to(package).parts]
    return sorted([*kept, *(ROOT / "tg4mm" / name for name in _GENERATOR_NEEDS)])


def build(staged: Path, out: Path) -> Path:
    """Pack a staged folder as OUT/<id>-<version>.zip, the same bytes from the same files; returns its path.

    Raises ValueError for a manifest without an id, a version or a schema version, or with another version than tg4mm.
    """
    manifest = tomllib.loads((staged / "blender_manifest.toml").read_text(encoding="utf-8"))
    if missing := [
        key for key in ("schema_version", "id", "version") if not isinstance(manifest.get(key), str)
    ]:
        raise ValueError(f"{staged / 'blender_manifest.toml'} has no {missing[0]}")
    if manifest["version"] != (own := _version()):
        raise ValueError(
            f"blender_manifest.toml is of version {manifest['version']}, tg4mm of {own}: make them equal"
        )
    out.mkdir(parents=True, exist_ok=True)
    target = out / f"{manifest['id']}-{manifest['version']}.zip"
    temporary = target.with_name(
        f".{target.name}.tmp"
    )  # a kill leaves no half zip under the name that is installed
    try:
        with zipfile.ZipFile(temporary, "w") as archive:
            for file in sorted(file for file in staged.rglob("*") if file.is_file()):
                entry = zipfile.ZipInfo(file.relative_to(staged).as_posix(), _DATE)
                entry.external_attr = 0o644 << 16
                archive.writestr(entry, file.read_bytes(), zipfile.ZIP_DEFLATED)
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)
    return target


def _version() -> str:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    return str(tomllib.loads(text)["project"]["version"])


def main() -> None:
    """`python addon/make_extension.py`: build/extension/ staged, dist/tg4mm-<version>.zip built."""
    print(build(stage(ROOT / "build" / "extension"), ROOT / "dist"))


if __name__ == "__main__":
    main()
