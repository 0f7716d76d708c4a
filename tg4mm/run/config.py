"""A run's config.json: the request of its training, and its comparison with another."""

import os
import platform
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path, PurePath
from typing import Any

from tg4mm.core import __version__
from tg4mm.core.errors import RunError
from tg4mm.core.values import require
from tg4mm.core.work_folder import WorkFolder

FORMAT = "tg4mm"
VERSION = 1
_FORM = {"dataset": str, "dataset_from_run": str, "preset": str, "settings": dict, "versions": dict}
_STAGES = ("space", "motion", "paper")


def work_folder(path: Path | str) -> WorkFolder:
    """Return the run folder `path` as the folder of a request."""
    return WorkFolder(Path(path), "config.json")


def new_config(path: Path, dataset: Path, preset: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of config.json for the run folder `path`; `dataset` absolute, `settings` JSON values."""
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
    """Return the path from a run to its dataset, with / on every system; the dataset itself if there is none."""
    try:
        return os.path.relpath(dataset, path).replace(os.sep, "/")
    except ValueError:  # on Windows, for folders on different drives
        return str(dataset)


def read_config(path: Path) -> dict[str, Any]:
    """Read config.json of the run folder `path`. Raises RunError if it is missing, truncated or foreign."""
    folder = work_folder(path)
    if (config := folder.read()) is None:
        raise RunError(f"{path} is not a run folder: it has no config.json")
    file = path / folder.record
    found = config.get("format"), config.get("kind")
    if found != (FORMAT, "run"):
        raise RunError(f"{file} is not a tg4mm run: format {found[0]!r}, kind {found[1]!r}")
    if config.get("version") != VERSION:
        raise RunError(f"{file} has version {config.get('version')!r}; this program reads {VERSION}")
    for key, rule in _FORM.items():
        require(f"{file}: {key}", config.get(key), rule, RunError)
    for stage in _STAGES:
        require(f"{file}: settings of {stage}", config["settings"].get(stage, {}), dict, RunError)
    return config


def dataset_folder(path: Path, config: Mapping[str, Any]) -> Path:
    """Return the dataset of a run: the recorded folder, or the same relative to the run if both were moved."""
    absolute = Path(config["dataset"])
    try:
        beside = (path / config["dataset_from_run"]).resolve()
        return beside if beside.exists() and not absolute.exists() else absolute
    except (OSError, ValueError):  # a name too long for any folder, or with a null character
        return absolute


def request_of(path: Path, config: Mapping[str, Any]) -> dict[str, Any]:
    """Return a run's request (dataset, preset, settings), as `WorkFolder.claim` compares it."""
    return {"dataset": str(dataset_folder(path, config)), "preset": config["preset"], **config["settings"]}


def _versions() -> dict[str, str]:
    versions = {"tg4mm": __version__, "python": platform.python_version()}
    for name in ("torch", "numpy", "numba"):
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return versions
