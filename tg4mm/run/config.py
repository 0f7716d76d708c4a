"""A run's config.json: what training was asked for, and whether a second request is the same one."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path, PurePath
from typing import Any

from tg4mm import __version__
from tg4mm.core import untrusted
from tg4mm.core.errors import RunError
from tg4mm.core.lock import LOCK
from tg4mm.core.temporary import is_temporary

FORMAT = "tg4mm"
VERSION = 1
_KINDS = {"dataset": str, "dataset_from_run": str, "preset": str, "settings": dict, "versions": dict}


def new_config(path: Path, dataset: Path, preset: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    """The content of config.json for the run folder `path`; `dataset` absolute, `settings` JSON values."""
    return {
        "format": FORMAT,
        "kind": "run",
        "version": VERSION,
        "dataset": str(dataset),
        "dataset_from_run": _from_run(dataset, path.resolve()),
        "preset": preset,
        "settings": dict(settings),
        "versions": _versions(),
    }


def _from_run(dataset: PurePath, path: PurePath) -> str:
    """The way from a run to its dataset, with / on every system; the dataset itself where there is none."""
    try:
        return os.path.relpath(dataset, path).replace(os.sep, "/")
    except ValueError:  # on Windows, for folders on different drives
        return str(dataset)


def read_config(path: Path) -> dict[str, Any]:
    """config.json of the run folder `path`. Raises RunError if it is missing, torn or foreign."""
    file = path / "config.json"
    if not file.is_file():
        raise RunError(f"{path} is not a run folder: it has no config.json")
    config = read_json(file)
    found = config.get("format"), config.get("kind")
    if found != (FORMAT, "run"):
        raise RunError(f"{file} is not a tg4mm run: format {found[0]!r}, kind {found[1]!r}")
    if config.get("version") != VERSION:
        raise RunError(f"{file} has version {config.get('version')!r}; this program reads {VERSION}")
    for key, kind in _KINDS.items():
        if not isinstance(config.get(key), kind):
            raise RunError(f"{file}: {key} is {config.get(key)!r}, expected {kind.__name__}")
    return config


def read_json(file: Path) -> dict[str, Any]:
    """A JSON object. Raises RunError if `file` is torn or holds anything else."""
    try:
        value = untrusted.read_json(file, finite=True)
    except (OSError, ValueError) as error:
        raise RunError(f"{file} is not readable JSON: {error}") from None
    if not isinstance(value, dict):
        raise RunError(f"{file} holds {type(value).__name__}, expected an object")
    return value


def dataset_folder(path: Path, config: Mapping[str, Any]) -> Path:
    """The dataset of a run: where it was, or at the same place relative to the run if both were moved."""
    absolute = Path(config["dataset"])
    try:
        beside = (path / config["dataset_from_run"]).resolve()
        return beside if beside.exists() and not absolute.exists() else absolute
    except (OSError, ValueError):  # a name too long for any folder, or with a null character
        return absolute


def check_empty(path: Path) -> None:
    """Raise RunError if `path` holds anything, so that no run is mixed with foreign files."""
    if path.exists() and not path.is_dir():
        raise RunError(f"run folder {path} is a file")
    # A kill before config.json was renamed leaves only its temporary file and the lock: still an empty run.
    entries = path.iterdir() if path.is_dir() else ()
    foreign = sorted(e.name for e in entries if e.name != LOCK and not is_temporary(e, "config.json"))
    if foreign:
        raise RunError(f"{path} is not a run folder: it holds {foreign[0]!r} and no config.json")


def check_same(path: Path, config: Mapping[str, Any], asked: Mapping[str, Any]) -> None:
    """Raise RunError naming the first of dataset, preset and settings in which `asked` is not `config`."""
    new = {"dataset": str(asked["dataset"]), "preset": asked["preset"]} | _flat(asked["settings"])
    old = {"dataset": str(dataset_folder(path, config)), "preset": config["preset"]}
    old |= _flat(config["settings"])
    for key in [*new, *(k for k in old if k not in new)]:
        if (key in new) != (key in old) or new[key] != old[key]:
            raise RunError(
                f"{path} was made with {key} = {_shown(old, key)}, asked is {_shown(new, key)}: "
                "resume with the same value or give another run folder"
            )


def _flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested settings by dotted names, as on the command line: {"space": {"seed": 0}} is space.seed."""
    flat: dict[str, Any] = {}
    for key, value in settings.items():
        nested = isinstance(value, Mapping) and value
        flat |= _flat(value, f"{prefix}{key}.") if nested else {f"{prefix}{key}": value}
    return flat


def _shown(values: Mapping[str, Any], key: str) -> str:
    return json.dumps(values[key], ensure_ascii=False) if key in values else "(not set)"


def _versions() -> dict[str, str]:
    versions = {"tg4mm": __version__, "python": platform.python_version()}
    for name in ("torch", "numpy", "numba"):
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return versions
