"""Poses and pictures written as a dataset that the capture readers read (docs/conventions.md)."""

import shutil
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture.frames import index_of
from tg4mm.capture.model import SurfacePoints
from tg4mm.capture.points import write_points
from tg4mm.capture.sfm.clip import WHOLE, Clip, Frame, TimeWindow, clip_frames, save_png
from tg4mm.capture.sfm.survey import Survey
from tg4mm.capture.sfm.undistort import Lens
from tg4mm.capture.video import HAIR_S
from tg4mm.core.errors import CaptureError
from tg4mm.core.files import link_or_copy, write_atomic, write_json
from tg4mm.core.pictures.decode import decode
from tg4mm.core.progress import Update, progress

_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
COPIED = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff")
SPACING = 3  # pixels between points of the plane

# World to camera, OpenCV axes: the camera is at the origin, upright, and looks along +y.
VIEWMAT = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


@dataclass(frozen=True)
class Track:
    """One camera's pictures: a single one, or one at each of the timesteps 0 … T − 1."""

    name: str  # of its pictures in the dataset, without suffix
    clip: Clip  # where they come from
    lens: Lens
    viewmats: np.ndarray  # [T, 4, 4] world-to-camera, OpenCV axes
    times_s: np.ndarray | None = None  # [T] seconds on its own clock; None: of the scene at rest
    rows: np.ndarray | None = None  # [T] which of the clip's pictures; None: all
    window: TimeWindow = WHOLE
    may_test: bool = False  # whether it may be held out as a test camera

    def __len__(self) -> int:
        """T, the number of pictures."""
        return len(self.viewmats)

    def copied(self, source: Path | None) -> bool:
        """Return whether the file is copied unchanged, as for a pinhole camera."""
        return self.lens.keeps and source is not None and source.suffix.lower() in COPIED

    def file(self, row: int) -> str:
        """The name of the picture that is made of the clip's picture `row`."""
        source = self.clip.pictures[row] if self.clip.pictures else None
        suffix = source.suffix.lower() if source is not None and self.copied(source) else ".png"
        return f"{self.name}{suffix}"


def write_dataset(
    out: Path, tracks: list[Track], points: SurfacePoints, scene: dict[str, Any], test_every: int = 0
) -> None:
    """A NeRF-synthetic folder where all pictures are of one timestep, a tree with a folder for each timestep else.

    scene: what scene.json gets. test_every: every so-many-th camera that may be is a test camera, 0 for none. Pictures
    that are there are kept; scene.json comes last and says that all is complete.
    """
    n_timesteps = max(len(track) for track in tracks)
    folders = [out] if n_timesteps == 1 else [out / f"{t:03d}" for t in range(n_timesteps)]
    splits = _splits(tracks, test_every)
    frames = {track.name: video_frames_of(out, track) for track in tracks}
    with progress("dataset", sum(len(track) for track in tracks), "pictures") as update:
        done = 0
        for split, members in splits.items():
            for track in members:
                if frames[track.name] is None:
                    _write_pictures([folder / split for folder in folders[: len(track)]], track, update, done)
                done += len(track)
                update(done)
    for t, folder in enumerate(folders):
        for split, members in splits.items():
            seen = [track for track in members if t < len(track)]
            if seen:
                folder.mkdir(parents=True, exist_ok=True)
                up = "." if folder == out else ".."
                files = [_file(split, track, frames[track.name], t, up) for track in seen]
                entries = [_frame(track, t, file) for track, file in zip(seen, files, strict=True)]
                write_json(folder / f"transforms_{split}.json", {"frames": entries})
    if len(points.xyz):
        write_points(out / "points3d.ply", points)
    width, height = tracks[0].lens.size
    counts = {"n_train": len(splits["train"]), "n_test": len(splits["test"])}
    size = {"width": width, "height": height, "n_timesteps": n_timesteps}
    write_json(out / "scene.json", {"format_version": 1, **scene, **size, **counts})


def _splits(tracks: list[Track], test_every: int) -> dict[str, list[Track]]:
    if not test_every:
        return {"train": tracks, "test": []}
    able = [track for track in tracks if track.may_test]
    test = [track for i, track in enumerate(able) if i % test_every == test_every // 2]
    lengths = {len(track) for track in able}
    if len(able) - len(test) < 2:
        raise CaptureError(
            f"--test-every is {test_every}, which leaves {len(able) - len(test)} of {len(able)} cameras to train from"
        )
    if len(lengths) > 1:
        raise CaptureError(
            f"--test-every is {test_every}, but recordings have {min(lengths)} to {max(lengths)} frames; "
            "a test camera needs as many as the others: give --until"
        )
    held_out = {track.name for track in test}
    return {"train": [track for track in tracks if track.name not in held_out], "test": test}


def _rows(track: Track) -> list[int]:
    return list(range(len(track))) if track.rows is None else [int(row) for row in track.rows]


def _write_pictures(folders: list[Path], track: Track, update: Update, done: int) -> None:
    targets = {row: folder / track.file(row) for row, folder in zip(_rows(track), folders, strict=True)}
    missing = {row: target for row, target in targets.items() if not target.is_file()}
    if not missing:
        return
    if track.clip.pictures and all(track.copied(track.clip.pictures[row]) for row in missing):
        for k, (row, target) in enumerate(missing.items()):
            target.parent.mkdir(parents=True, exist_ok=True)
            write_atomic(target, partial(shutil.copyfile, track.clip.pictures[row]))
            update(done + k + 1)
        return
    written = 0
    for frame in clip_frames(track.clip, track.window):
        if frame.index in missing:
            missing[frame.index].parent.mkdir(parents=True, exist_ok=True)
            _write_picture(missing[frame.index], track.lens, frame)
            written += 1
            update(done + written)
        if written == len(missing):
            break


def _write_picture(target: Path, lens: Lens, frame: Frame) -> None:
    deep = lens.keeps and frame.pixels.dtype == np.uint16
    image = frame.pixels if deep else lens.apply(frame.pixels)
    if image.shape[2] == 4 and (image[..., 3] == np.iinfo(image.dtype).max).all():
        image = image[..., :3]
    save_png(target, image, level=3)


def video_of(out: Path, clip: Clip) -> Path:
    """The clip's video in the dataset, a link where that can be."""
    linked = out / "video" / clip.path.name
    if not linked.exists():
        link_or_copy(clip.path, linked)
    return linked


def video_frames_of(out: Path, track: Track) -> list[str] | None:
    """Return [T] the track's pictures as frames of its video in the dataset; None where they are files.

    So are those that are undistorted, and those of a container that does not list every frame.
    """
    if not (track.clip.is_coded and track.lens.keeps) or track.clip.is_untimed:
        return None
    low, high = track.window.start_s - HAIR_S, track.window.stop_s - HAIR_S
    inside = (n for n, time in enumerate(index_of(track.clip.path).times) if low <= time < high)
    numbers = [n for row, n in enumerate(inside) if row not in track.clip.repeats]
    if len(numbers) != len(track):
        return None
    return [f"video/{video_of(out, track.clip).name}#{n}" for n in numbers]


def _file(split: str, track: Track, frames: list[str] | None, t: int, up: str) -> str:
    """Return the path of picture t relative to its timestep's folder; `up` leads from there to the dataset."""
    return f"./{split}/{track.file(_rows(track)[t])}" if frames is None else f"{up}/{frames[t]}"


def _frame(track: Track, t: int, file: str) -> dict[str, Any]:
    """The frame as transforms_<split>.json has it."""
    pose = np.linalg.inv(track.viewmats[t]) @ _OPENGL_FROM_OPENCV
    K, (width, height) = track.lens.K, track.lens.size
    frame = {
        "file_path": file,
        "transform_matrix": pose.tolist(),
        "fl_x": K[0, 0],
        "fl_y": K[1, 1],
        "cx": K[0, 2],
        "cy": K[1, 2],
        "w": width,
        "h": height,
    }
    return frame if track.times_s is None else frame | {"time": float(track.times_s[t])}


def write_flat(
    out: Path, clip: Clip, survey: Survey, times_s: np.ndarray, window: TimeWindow, scene: dict[str, Any]
) -> int:
    """Write the clip as a tree of timesteps seen from the origin along +y, the scene being the plane y = 1.

    A pixel is then 1/f of a scene unit with f = max(width, height), `pixels_per_unit`. Returns the number of points.
    """
    width, height = survey.size
    focal = float(max(width, height))
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    points = plane_points(decode(survey.mean)[..., :3], focal)
    viewmats = np.tile(VIEWMAT, (len(survey), 1, 1))
    track = Track(clip.name, clip, Lens(K, survey.size, None), viewmats, times_s, window=window)
    write_dataset(out, [track], points, scene | {"pixels_per_unit": focal, "unit_scale_m": None})
    return len(points.xyz)


def plane_points(picture: np.ndarray, focal: float) -> SurfacePoints:
    """A regular grid of points on the plane y = 1 with the colours of picture [H, W, 3] uint8, f in pixels."""
    height, width = picture.shape[:2]
    u, v = np.meshgrid(_centres(width), _centres(height))
    xyz = np.stack([(u - width / 2) / focal, np.ones_like(u), -(v - height / 2) / focal], axis=-1)
    rgb = picture[v.astype(int), u.astype(int)]
    return SurfacePoints(xyz.reshape(-1, 3).astype(np.float32), rgb.reshape(-1, 3))


def _centres(pixels: int) -> np.ndarray:
    """Places some SPACING pixels apart, centred, half of that from both edges."""
    n = max(1, round(pixels / SPACING))
    return (np.arange(n) + 0.5) * pixels / n
