"""The dataset on disk (design §4.2): scene.json, poses, atomic writing, linking, what a complete file is."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from . import png
from .cameras import transforms
from .plan import cameras_of, magnified_folder
from .scene import Scene
from .settings import GenerateError, Settings

FORMAT_VERSION = 1
_EXR_HEAD = b"\x76\x2f\x31\x01"


def write_bytes(path: Path, data: bytes) -> None:
    """Writes a file under a temporary name, then renames it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = temporary_name(path)
    temporary.write_bytes(data)
    os.replace(temporary, path)


def temporary_name(path: Path) -> Path:
    """A name in the same folder that no reader takes for data; `clean` removes what a kill left."""
    return path.with_name(f".{path.stem}.{os.getpid()}.tmp{path.suffix}")


def clean(root: Path) -> None:
    """Removes temporary files of a killed run."""
    for left in root.rglob(".*.tmp.*"):
        left.unlink(missing_ok=True)


def write_json(path: Path, data: Any) -> None:
    write_bytes(path, (json.dumps(data, indent=2) + "\n").encode())


def exr_complete(path: Path, width: int, height: int) -> bool:
    """True for an OpenEXR file of this size. Its header is checked; that it is whole, the rename sees to."""
    try:
        with path.open("rb") as file:
            data = file.read(4096)
            size = file.seek(0, os.SEEK_END)
    except OSError:
        return False
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    return data.startswith(_EXR_HEAD) and window in data and size > 8 * height


def complete(path: Path, width: int, height: int) -> bool:
    """Whether a picture or truth file is there and whole."""
    return (png.complete if path.suffix == ".png" else exr_complete)(path, width, height)


def link(source: Path, targets: Iterable[Path]) -> None:
    """Makes every target the same file as `source`: a hard link, or a copy where links are not to be had."""
    for target in targets:
        if target == source:
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary = temporary_name(target)
        with contextlib.suppress(FileNotFoundError):
            temporary.unlink()
        try:
            os.link(source, temporary)
        except OSError:
            shutil.copyfile(source, temporary)
        # Renaming a link over another link to the same file does nothing: remove the target first.
        target.unlink(missing_ok=True)
        os.replace(temporary, target)


def describe(
    settings: Settings, scene: Scene, engine: dict[str, object], versions: dict[str, str]
) -> dict[str, Any]:
    """Content of scene.json: everything the files depend on, so two equal descriptions mean equal data."""
    return {
        "format_version": FORMAT_VERSION,
        "scene": settings.scene,
        "fps": settings.fps,
        "n_timesteps": settings.timesteps,
        "frequency_hz": settings.frequency,
        "amplitude": settings.amplitude,
        "unit_scale_m": scene.unit_scale_m,
        "modes": [mode.describe() for mode in scene.modes],
        "seed": settings.seed,
        "engine": engine,
        "alphas": list(settings.alphas),
        "background": "transparent",
        "width": settings.size,
        "height": settings.size,
        "n_train": settings.views,
        "n_test": settings.test_views,
        "n_points": settings.points,
        "truth": settings.truth,
        **versions,
    }


def _leaves(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested dictionaries as one, with keys such as "engine.samples"."""
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        flat.update(_leaves(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value})
    return flat


def claim(root: Path, description: dict[str, Any]) -> None:
    """Takes a new, empty or unfinished folder of the same description; refuses any other with one line."""
    path = root / "scene.json"
    description = json.loads(json.dumps(description))
    if root.exists() and not root.is_dir():
        raise GenerateError(f"{root} is a file, not a folder")
    if path.exists():
        try:
            old = json.loads(path.read_text())
        except (OSError, ValueError) as error:
            raise GenerateError(f"{path} cannot be read: {error}") from error
        if not isinstance(old, dict):
            raise GenerateError(f"{path} is not a dataset's description")
        old, new = _leaves(old), _leaves(description)
        for key in sorted({*old, *new}):
            if old.get(key) != new.get(key):
                raise GenerateError(
                    f"{root} holds another dataset: {key} is {old.get(key)!r}, "
                    f"asked for {new.get(key)!r}; choose another --out or remove it"
                )
        return
    if root.exists() and any(root.iterdir()):
        raise GenerateError(f"{root} is not empty and holds no scene.json: choose another --out")
    try:
        write_json(path, description)
    except OSError as error:
        raise GenerateError(f"{root} cannot be written: {error.strerror}") from error


def write_poses(root: Path, settings: Settings) -> list[Path]:
    """All transforms_<split>.json of the set: the same poses at every timestep, the time in seconds."""
    cameras = cameras_of(settings)
    written = []
    for t in range(settings.timesteps):
        folders = [(root / f"{t:03d}", split) for split in cameras]
        folders += [(root / magnified_folder(a) / f"{t:03d}", "test") for a in settings.alphas]
        for folder, split in folders:
            if cameras[split]:
                path = folder / f"transforms_{split}.json"
                data = transforms(cameras[split], split, t / settings.fps, settings.size, settings.size)
                write_json(path, data)
                written.append(path)
    return written
