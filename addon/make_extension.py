"""Build the extension's zip, by Python's own library alone: stage a folder that is the package, then pack it."""

import base64
import hashlib
import shutil
import tomllib
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
_DATE = (1980, 1, 1, 0, 0, 0)  # of every file in an archive
# Of tg4mm/core, what needs more than numpy.
_NEED_MORE = ("pages", "metrics.py", "pictures/decode.py")
_METADATA = "Metadata-Version: 2.4\nName: {name}\nVersion: {version}\nLicense-Expression: GPL-3.0-or-later\n"
_WHEEL = "Wheel-Version: 1.0\nGenerator: make_extension\nRoot-Is-Purelib: true\nTag: py3-none-any\n"


def stage(folder: Path) -> Path:
    """Fill `folder` (made anew) with the extension as Blender loads it, and return it."""
    if folder.exists():
        shutil.rmtree(folder)
    left_out = shutil.ignore_patterns("__pycache__", Path(__file__).name)
    shutil.copytree(ROOT / "addon", folder, ignore=left_out)
    for name in ("blender_manifest.toml", "LICENSE"):
        shutil.copyfile(ROOT / name, folder / name)
    (wheel,) = _manifest(folder)["wheels"]
    _write_wheel(folder / wheel)
    return folder


def wheel_files() -> list[Path]:
    """Return the files of the wheel: the core that needs numpy alone, and the generator without its cluster part."""
    core, generator = ROOT / "tg4mm" / "core", ROOT / "dataset_gen"
    left_out = tuple(str(core / name) for name in _NEED_MORE)
    found = [file for file in core.rglob("*.py") if not str(file).startswith(left_out)]
    for kind in ("*.py", "*.yaml"):
        found += [f for f in generator.rglob(kind) if f.relative_to(generator).parts[0] != "farm"]
    return sorted([*found, ROOT / "tg4mm" / "__init__.py"])


def _write_wheel(target: Path) -> None:
    name, version, *_ = target.stem.split("-")
    info = f"{name}-{version}.dist-info"
    parts = [(file.relative_to(ROOT).as_posix(), file.read_bytes()) for file in wheel_files()]
    parts.append((f"{info}/METADATA", _METADATA.format(name=name, version=version).encode()))
    parts.append((f"{info}/WHEEL", _WHEEL.encode()))
    record = "".join(f"{path},sha256={_digest(data)},{len(data)}\n" for path, data in parts)
    target.parent.mkdir(parents=True)
    _pack(target, [*parts, (f"{info}/RECORD", f"{record}{info}/RECORD,,\n".encode())])


def _digest(data: bytes) -> str:
    return base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()


def build(staged: Path, out: Path) -> Path:
    """Pack a staged folder as OUT/<id>-<version>.zip, the same bytes from the same files; returns its path.

    Raises ValueError for a manifest without an id, a version or a schema version, or with another version than tg4mm.
    """
    manifest = _manifest(staged)
    if missing := [k for k in ("schema_version", "id", "version") if not isinstance(manifest.get(k), str)]:
        raise ValueError(f"{staged / 'blender_manifest.toml'} has no {missing[0]}")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    if manifest["version"] != project["version"]:
        raise ValueError(
            f"blender_manifest.toml is of version {manifest['version']}, tg4mm of {project['version']}: make them equal"
        )
    out.mkdir(parents=True, exist_ok=True)
    target = out / f"{manifest['id']}-{manifest['version']}.zip"
    temporary = target.with_name(f".{target.name}.tmp")  # a kill leaves no half zip under the name
    try:
        files = sorted(file for file in staged.rglob("*") if file.is_file())
        _pack(temporary, ((file.relative_to(staged).as_posix(), file.read_bytes()) for file in files))
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)
    return target


def _manifest(folder: Path) -> dict[str, Any]:
    return tomllib.loads((folder / "blender_manifest.toml").read_text(encoding="utf-8"))


def _pack(target: Path, parts: Iterable[tuple[str, bytes]]) -> None:
    with zipfile.ZipFile(target, "w") as archive:
        for path, data in parts:
            entry = zipfile.ZipInfo(path, _DATE)
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, data, zipfile.ZIP_DEFLATED)


def main() -> None:
    """`python addon/make_extension.py`: build/extension/ staged, dist/tg4mm-<version>.zip built."""
    print(build(stage(ROOT / "build" / "extension"), ROOT / "dist"))


if __name__ == "__main__":
    main()
