"""What `tg4mm sfm` was asked for, kept in the folder it works in, so that only the same request goes on there."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tg4mm.capture.scene import read_scene
from tg4mm.capture.sfm.sources import Sources
from tg4mm.core.errors import CaptureError
from tg4mm.core.files import write_json
from tg4mm.core.records import read_record
from tg4mm.core.temporary import remove_leftovers

NAME = "request.json"
# Settings that change scene.json and the frames' times alone: asked for anew, those are written again.
SCENE_ONLY = ("unit_scale_m", "baseline", "length", "fps")


@dataclass(frozen=True)
class Work:
    """The folder OUT/sfm/ of one request."""

    out: Path
    folder: Path
    settings: dict[str, Any]

    @property
    def scene_only(self) -> dict[str, Any]:
        """The settings that change scene.json and the frames' times alone."""
        return {key: self.settings[key] for key in SCENE_ONLY if key in self.settings}

    def finished(self) -> dict[str, Any] | None:
        """What scene.json says of the reconstruction; None if the dataset is not complete, or of another scale."""
        path = self.out / "scene.json"
        if not path.is_file():
            return None
        report = read_scene(self.out, needs_fps=False).values.get("sfm") or {}
        return report if report.get("asked") == self.scene_only else None


def open_request(out: Path, sources: Sources, settings: dict[str, Any]) -> Work:
    """OUT/sfm/, made or found again. Raises CaptureError where OUT holds other things, or another request's."""
    asked = json.loads(json.dumps({"pictures": _files(sources), "settings": settings}))
    folder = out / "sfm"
    path = folder / NAME
    if path.is_file():
        try:
            before = read_record(path).values
        except CaptureError as error:
            raise CaptureError(f"{error}; remove it, or give another --out") from None
        _check_same(out, before, asked)
        remove_leftovers(out)
        return Work(out, folder, asked["settings"])
    # A kill before request.json was renamed leaves its temporary file: that is still nothing.
    begun = [p.name for p in folder.iterdir() if not p.name.startswith(".")] if folder.is_dir() else []
    held = [p.name for p in out.iterdir() if p != folder or begun] if out.is_dir() else []
    if held or (out.exists() and not out.is_dir()):
        what = f"holds {min(held)}" if held else "is a file"
        raise CaptureError(f"{out}: {what}; expected a new or empty folder, or one that tg4mm sfm has begun")
    folder.mkdir(parents=True, exist_ok=True)
    write_json(path, asked)
    return Work(out, folder, asked["settings"])


def _files(sources: Sources) -> dict[str, list[Any]]:
    """Path and, for each file, its size and time of change."""

    def stamp(path: Path) -> list[Any]:
        state = path.stat()
        return [path.name, state.st_size, state.st_mtime_ns]

    files = {}
    for clip in sources.every():
        files[str(clip.path.resolve())] = [stamp(p) for p in (clip.pictures or (clip.path,))]
    return files


def _check_same(out: Path, before: dict[str, Any], asked: dict[str, Any]) -> None:
    if before.get("pictures") != asked["pictures"]:
        raise CaptureError(f"{out}: was begun with other pictures, or they have changed; give another --out")
    for key, value in asked["settings"].items():
        old = settings.get(key) if isinstance(settings := before.get("settings"), dict) else None
        if old != value and key not in SCENE_ONLY:
            raise CaptureError(
                f"{out}: was begun with {key} = {old}, asked is {value}; give the same or another --out"
            )
