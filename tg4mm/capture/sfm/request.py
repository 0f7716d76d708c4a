"""What `tg4mm sfm` was asked for, kept in the folder it works in, so that only the same request goes on there."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tg4mm.capture.scene import read_scene
from tg4mm.capture.sfm.sources import Sources
from tg4mm.core.errors import CaptureError
from tg4mm.core.temporary import remove_leftovers
from tg4mm.core.work_folder import WorkFolder

NAME = "request.json"
# Settings that change scene.json and the frames' times alone: asked for anew, those are written again.
SCENE_ONLY = ("unit_scale_m", "baseline", "length", "fps")


@dataclass(frozen=True)
class Work:
    """The folder OUT/sfm/ of one request."""

    out: Path
    owned: WorkFolder
    settings: dict[str, Any]

    @property
    def folder(self) -> Path:
        """Where everything unfinished lies."""
        return self.owned.path

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
    work = WorkFolder(
        out / "sfm",
        NAME,
        CaptureError,
        others={"pictures": "of other pictures, or they have changed"},
        free=SCENE_ONLY,
    )
    if not (work.path / NAME).is_file():
        work.check()
        others = [p.name for p in out.iterdir() if p != work.path] if out.is_dir() else []
        if others or (out.exists() and not out.is_dir()):
            what = f"holds {min(others)}" if others else "is a file"
            raise CaptureError(
                f"{out}: {what}; expected a new or empty folder, or one that tg4mm sfm has begun"
            )
    work.claim(
        {"pictures": asked["pictures"], **asked["settings"]},
        asked,
        lambda found: {"pictures": found.get("pictures"), **_dict(found.get("settings"))},
    )
    remove_leftovers(out)
    return Work(out, work, asked["settings"])


def _dict(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _files(sources: Sources) -> dict[str, list[Any]]:
    """Path and, for each file, its size and time of change."""

    def stamp(path: Path) -> list[Any]:
        state = path.stat()
        return [path.name, state.st_size, state.st_mtime_ns]

    files = {}
    for clip in sources.every():
        files[str(clip.path.resolve())] = [stamp(p) for p in (clip.pictures or (clip.path,))]
    return files
