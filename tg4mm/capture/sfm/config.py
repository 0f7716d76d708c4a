"""The request of `tg4mm sfm`, checked and kept in its working folder, where only the same request is resumed."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tg4mm.capture.options import Matching, SfmConfig
from tg4mm.capture.scene import read_scene
from tg4mm.capture.sfm.clip import FEWEST, Sources
from tg4mm.capture.sfm.scale import checked_length
from tg4mm.core.errors import CaptureError, Tg4mmError
from tg4mm.core.files import remove_leftovers
from tg4mm.core.values import NOT_NEGATIVE, POSITIVE, Choice, Either, Just, Maybe, Number, require
from tg4mm.core.work_folder import WorkFolder

CAMERA_MODELS = (
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "OPENCV_FISHEYE",
    "FULL_OPENCV",
)

DEFAULTS = SfmConfig()
NAME = "request.json"
# Settings that change scene.json and the frames' times alone: asked for anew, those are written again.
SCENE_ONLY = ("unit_scale_m", "baseline", "length", "fps", "readout_s")


def checked(config: SfmConfig) -> SfmConfig:
    """`config`. Raises Tg4mmError on a value out of range."""
    seconds = Number(config.start_s, above=True)
    checks: dict[str, tuple[object, object]] = {
        "camera-model": (config.camera_model, Choice(*CAMERA_MODELS)),
        "focal-px": (config.focal_px, Maybe(POSITIVE)),
        "matching": (config.matching, Choice(*Matching)),
        "frames": (config.frames, Maybe(Number(FEWEST, whole=True))),
        "fps": (config.fps, Maybe(POSITIVE)),
        "readout": (None if config.readout_s is None else 1e3 * config.readout_s, Maybe(NOT_NEGATIVE)),
        "from": (config.start_s, NOT_NEGATIVE),
        "until": (config.stop_s, Maybe(seconds)),
        "unit-scale-m": (config.unit_scale_m, Maybe(POSITIVE)),
        "baseline": (config.baseline[2] if config.baseline else None, Maybe(POSITIVE)),
        "test-every": (config.test_every, Either(Just(0), Number(2, whole=True))),
        "seed": (config.seed, Number(0, 2**31 - 1, whole=True)),
    }
    for name, (value, rule) in checks.items():
        require(f"--{name}", value, rule, Tg4mmError)
    scales = {
        "--unit-scale-m": config.unit_scale_m,
        "--baseline": config.baseline,
        "--length": config.length and checked_length(config.length),
    }
    given = [name for name, value in scales.items() if value is not None]
    if len(given) > 1:
        raise Tg4mmError(
            f"{' and '.join(given)} cannot be used together: each gives the scene's scale; give only one"
        )
    return config


@dataclass(frozen=True)
class Work:
    """The folder OUT/sfm/ of one request."""

    out: Path
    owned: WorkFolder
    settings: dict[str, Any]
    is_new: bool = False  # begun by this call
    made_out: bool = False

    @property
    def folder(self) -> Path:
        """Return the folder of unfinished work."""
        return self.owned.path

    @property
    def scene_only(self) -> dict[str, Any]:
        """The settings that change scene.json and the frames' times alone."""
        return {key: self.settings[key] for key in SCENE_ONLY if key in self.settings}

    def forget(self) -> None:
        """Remove what this call made, since its input is refused and its folder would block another request."""
        if self.is_new:
            shutil.rmtree(self.folder)
        if self.made_out and not any(self.out.iterdir()):
            self.out.rmdir()

    def finished(self) -> dict[str, Any] | None:
        """Return the reconstruction record of scene.json, or None if the dataset is incomplete or has another scale."""
        path = self.out / "scene.json"
        if not path.is_file():
            return None
        report = read_scene(self.out, needs_fps=False).values.get("sfm") or {}
        return report if _given(report.get("asked")) == _given(self.scene_only) else None


def open_request(out: Path, sources: Sources, settings: dict[str, Any]) -> Work:
    """OUT/sfm/, made or found again. Raises CaptureError where OUT holds other things, or another request's."""
    request = json.loads(json.dumps({"pictures": files_of(sources), "settings": settings}))
    work = WorkFolder(
        out / "sfm",
        NAME,
        CaptureError,
        others={"pictures": "of other pictures, or they have changed"},
        free=SCENE_ONLY,
    )
    made, is_new = not out.exists(), not (work.path / NAME).is_file()
    if is_new:
        work.check()
        others = [p.name for p in out.iterdir() if p != work.path] if out.is_dir() else []
        if others or (out.exists() and not out.is_dir()):
            what = f"holds {min(others)}" if others else "is a file"
            raise CaptureError(
                f"{out}: {what}; expected a new or empty folder, or one that tg4mm sfm has begun"
            )
    work.claim(
        {"pictures": request["pictures"], **request["settings"]},
        request,
        lambda found: {"pictures": found.get("pictures"), **_dict(found.get("settings"))},
    )
    remove_leftovers(out)
    return Work(out, work, request["settings"], is_new, made)


def _given(request: Any) -> dict[str, Any]:
    """Drop values that are None, as those unknown to an earlier version."""
    return {key: value for key, value in _dict(request).items() if value is not None}


def _dict(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def files_of(sources: Sources) -> dict[str, list[Any]]:
    """Path and, for each file, its size and time of change."""

    def stamp(path: Path) -> list[Any]:
        state = path.stat()
        return [path.name, state.st_size, state.st_mtime_ns]

    files = {}
    for clip in sources.every():
        files[str(clip.path.resolve())] = [stamp(p) for p in (clip.pictures or (clip.path,))]
    return files
