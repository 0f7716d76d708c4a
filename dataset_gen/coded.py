"""Sets whose pictures go through a video: the step between rendering and the finished folder.

What is rendered lies in a working folder until all frames of a camera are there. They become one video, and the
video's frames the set's pictures. A picture without its camera's other frames could not be made again, so a
camera is finished as a whole or not at all.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tg4mm.core.progress import progress

from . import png, tree
from .cameras import Camera, cameras_at, films
from .effects import codec
from .plan import UNCODED, picture_path
from .settings import Settings

VIDEOS = "video"
_SWEEP = "sweep"  # where `tg4mm sfm` looks for photographs beside the videos


def begin(root: Path, settings: Settings) -> None:
    """Before rendering: of a camera that lacks some of its pictures all are removed, and will be rendered."""
    for camera in _cameras(settings):
        if not _finished(root, settings, camera) and not _rendered(root, settings, camera):
            for name in _names(settings, camera):
                (root / name).unlink(missing_ok=True)


def finish(root: Path, settings: Settings) -> None:
    """After rendering: every camera whose frames are all there gets its video, and its pictures from that."""
    cameras = list(_cameras(settings))
    with progress("videos", len(cameras), "cameras", brief=True) as update:
        for done, camera in enumerate(cameras, 1):
            if not _finished(root, settings, camera) and _rendered(root, settings, camera):
                _code(root, settings, camera)
            update(done)


def clean(root: Path, settings: Settings) -> None:
    """When the set is complete: what was only needed on the way goes."""
    if not settings.effects.coded:
        return
    shutil.rmtree(root / UNCODED, ignore_errors=True)
    if settings.effects.keep_video:
        sweep = [c for c in cameras_at(settings.cameras, 0)["train"] if not films(settings.cameras, c)]
        for camera in sweep:
            picture = root / picture_path(settings, 0, camera)
            tree.link(picture, [root / VIDEOS / _SWEEP / picture.name])


def _cameras(settings: Settings) -> Iterator[Camera]:
    """Each camera that films, as it stands at timestep 0."""
    for camera in cameras_at(settings.cameras, 0)["train"] if settings.effects.coded else ():
        if films(settings.cameras, camera):
            yield camera


def _names(settings: Settings, camera: Camera) -> list[str]:
    return [picture_path(settings, t, camera) for t in range(settings.timesteps)]


def _finished(root: Path, settings: Settings, camera: Camera) -> bool:
    kept = not settings.effects.keep_video or _video(root, camera).is_file()
    return kept and all(tree.complete(root, name, settings) for name in _names(settings, camera))


def _rendered(root: Path, settings: Settings, camera: Camera) -> bool:
    return all((root / UNCODED / name).is_file() for name in _names(settings, camera))


def _video(root: Path, camera: Camera) -> Path:
    return root / VIDEOS / f"{camera.name}.mp4"


def _read(path: Path) -> np.ndarray:
    """[H, W, 3] uint8."""
    from tg4mm.core.pictures.decode import decode  # it needs Pillow, which Blender's own Python lacks

    return decode(path)[..., :3]


def _code(root: Path, settings: Settings, camera: Camera) -> None:
    names = _names(settings, camera)
    pictures = (_read(root / UNCODED / name) for name in names)
    video = _video(root, camera) if settings.effects.keep_video else root / UNCODED / f"{camera.name}.mp4"
    tree.write_bytes(video, codec.encode(pictures, settings.size, settings.fps, settings.effects.crf))
    for name, picture in zip(names, codec.decode(video), strict=True):
        tree.write_bytes(root / name, png.encode(picture))
