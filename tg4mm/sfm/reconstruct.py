"""From photographs, a video or fixed cameras to a dataset: the steps of `tg4mm sfm`, each done once.

OUT/sfm/request.json   what was asked for, so that another request is refused
OUT/sfm/frames/        frames of videos
OUT/sfm/images/, masks/, database.db, sparse/0/   COLMAP's own files, the last the result in its own world
OUT/…                  the dataset; scene.json, written last, says that it is complete
"""

from __future__ import annotations

import math
import warnings
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.errors import CaptureError, Tg4mmError
from tg4mm.sfm.dataset import PosedCamera, write_dataset
from tg4mm.sfm.engine import colmap
from tg4mm.sfm.mapping import (
    EXHAUSTIVE_MOST,
    check_registered,
    find_poses,
    picture_pairs,
    registered,
    save_model,
    shown_names,
)
from tg4mm.sfm.orient import Similarity, world_of
from tg4mm.sfm.points import SfmPoints, points_of
from tg4mm.sfm.request import open_request
from tg4mm.sfm.sources import FEWEST, Sources, check_frames, find_sources
from tg4mm.sfm.staging import Shot, check_sizes, make_database, shots, stage, staged_name
from tg4mm.sfm.undistort import lenses
from tg4mm.sfm.video import extract_frames, video_fps

CAMERA_MODELS = (
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "OPENCV_FISHEYE",
    "FULL_OPENCV",
)
MATCHING = ("auto", "exhaustive", "sequential")
FRAMES = 100  # taken from a moving camera's video where nothing else is asked for


@dataclass(frozen=True)
class SfmConfig:
    """How poses are found and what the dataset says."""

    camera_model: str = "SIMPLE_RADIAL"  # COLMAP's name of the lens model; one bend is enough for most
    focal_px: float | None = (
        None  # pixels, a first guess that is refined; None: EXIF, or 1.2 × the longer side
    )
    each: bool = False  # every photograph or fixed camera has intrinsics of its own, else all share them
    matching: str = "auto"  # exhaustive up to EXHAUSTIVE_MOST pictures and for photographs, else sequential
    frames: int | None = None  # taken from a moving camera's video, evenly; None: FRAMES
    fps: float | None = None  # of fixed cameras, Hz; None: as their videos say
    unit_scale_m: float | None = None  # metres per scene unit
    baseline: tuple[str, str, float] | None = None  # two cameras (pictures) and their distance in metres
    test_every: int = 0  # every so-many-th camera is a test camera
    seed: int = 0


def checked(config: SfmConfig) -> SfmConfig:
    """`config`. Raises Tg4mmError on a value out of range."""

    def positive(x: float | None) -> bool:
        return x is None or (math.isfinite(x) and x > 0)

    length = config.baseline[2] if config.baseline else None
    checks: dict[str, tuple[bool, object, str]] = {
        "camera-model": (config.camera_model in CAMERA_MODELS, config.camera_model, ", ".join(CAMERA_MODELS)),
        "focal-px": (positive(config.focal_px), config.focal_px, "above 0"),
        "matching": (config.matching in MATCHING, config.matching, ", ".join(MATCHING)),
        "frames": (config.frames is None or config.frames >= FEWEST, config.frames, f">= {FEWEST}"),
        "fps": (positive(config.fps), config.fps, "above 0"),
        "unit-scale-m": (positive(config.unit_scale_m), config.unit_scale_m, "above 0"),
        "baseline": (positive(length), length, "a length above 0 m"),
        "test-every": (config.test_every == 0 or config.test_every >= 2, config.test_every, "0 or >= 2"),
        "seed": (0 <= config.seed < 1 << 31, config.seed, "0 to 2³¹ − 1"),
    }
    for name, (good, value, expected) in checks.items():
        if not good:
            raise Tg4mmError(f"--{name} is {value}, expected {expected}")
    if config.unit_scale_m is not None and config.baseline is not None:
        raise Tg4mmError("--unit-scale-m and --baseline exclude each other: both say how large the scene is")
    return config


def reconstruct(
    images: Path, out: Path, config: SfmConfig = SfmConfig(), threads: int = -1
) -> dict[str, Any]:
    """Poses and sparse points of the pictures in `images`, written to the folder `out` as a dataset.

    Goes on where it was stopped. threads: −1 for all cores; with 1 the result repeats bit for bit on one machine, with
    more only to the last digits. Returns what scene.json says under "sfm". Raises Tg4mmError (CaptureError) on bad
    input: too few pictures, no overlap, pictures that could not be placed.
    """
    colmap("tg4mm sfm")
    config = checked(config)
    sources = find_sources(images)
    fps, config = _fps(sources, config), replace(config, frames=_frames(sources, config))
    work = open_request(out, sources, asdict(config))
    done = work.finished(fps)
    if done is not None:
        return done
    sources = _with_frames(sources, work.folder, config)
    if sources.fixed:
        check_frames(sources)
    taken = shots(sources, config.each)
    model = _model(sources, taken, work.folder, config, threads)
    placed = registered(model)
    missing = check_registered(_needed(sources, taken), placed, sources.fixed)
    if missing:
        text = f"{len(missing)} pictures could not be placed and are left out: {shown_names(missing)}"
        warnings.warn(text, stacklevel=2)
    cameras, points = _cameras(sources, taken, placed, model)
    report = _report(model, taken, placed, points, config)
    scene: dict[str, Any] = {"scene": out.resolve().name, "background": "as photographed", "sfm": report}
    if sources.fixed:
        scene["fps"] = fps
    scene["unit_scale_m"] = _unit_scale(cameras, config)
    write_dataset(out, cameras, points, scene, config.test_every)
    return report


def _fps(sources: Sources, config: SfmConfig) -> float | None:
    if not sources.fixed:
        if config.fps is not None:
            raise Tg4mmError(
                f"--fps is {config.fps:g}, but there are no fixed cameras: photographs have no frame rate"
            )
        return None
    if config.fps is not None:
        return config.fps
    videos = [clip for clip in sources.clips if clip.is_video]
    if not videos:
        names = ", ".join(clip.name for clip in sources.clips[:4])
        raise Tg4mmError(f"--fps is missing: fixed cameras ({names}) need their frames per second")
    return video_fps(videos[0].path)


def _frames(sources: Sources, config: SfmConfig) -> int:
    moving = [*([] if sources.fixed else sources.clips), *([sources.sweep] if sources.sweep else [])]
    if config.frames is not None and not any(clip.is_video for clip in moving):
        raise Tg4mmError(
            f"--frames is {config.frames}, but there is no video of a moving camera to take them from"
        )
    return config.frames or FRAMES


def _with_frames(sources: Sources, work: Path, config: SfmConfig) -> Sources:
    """The sources with every video's frames extracted; of a moving camera's, so many evenly."""

    def extracted(clip, moving: bool):
        if not clip.is_video:
            return clip
        frames = extract_frames(clip.path, work / "frames" / clip.name, config.frames if moving else None)
        return replace(clip, pictures=frames)

    clips = tuple(extracted(clip, not sources.fixed) for clip in sources.clips)
    sweep = None if sources.sweep is None else extracted(sources.sweep, True)
    return replace(sources, clips=clips, sweep=sweep)


def _needed(sources: Sources, taken: list[Shot]) -> list[str]:
    """Names of the pictures that the dataset is made of: not the sweep."""
    n = len(sources.clips) if sources.fixed else len(taken)
    return [staged_name(shot) for shot in taken[:n]]


def _model(sources: Sources, taken: list[Shot], work: Path, config: SfmConfig, threads: int) -> Any:
    c = colmap("tg4mm sfm")
    sparse = work / "sparse" / "0"
    if sparse.is_dir():
        return c.Reconstruction(sparse)
    check_sizes(taken)
    if len(taken) < FEWEST:
        raise CaptureError(
            f"{len(taken)} pictures, at least {FEWEST} are needed; a sweep/ of further ones helps"
        )
    masks = stage(taken, work)
    database = make_database(taken, work, config.camera_model, config.focal_px)
    names = [staged_name(shot) for shot in taken]
    ordered = any(clip.is_video for clip in sources.clips) or sources.fixed
    sequential = config.matching == "sequential" or (
        config.matching == "auto" and ordered and len(names) > EXHAUSTIVE_MOST
    )
    pairs = picture_pairs(names, sequential)
    model = find_poses(database, work / "images", masks, names, pairs, config.seed, threads)
    check_registered(_needed(sources, taken), registered(model), sources.fixed)
    save_model(model, sparse)
    return model


def _cameras(
    sources: Sources, taken: list[Shot], placed: dict[str, Any], model: Any
) -> tuple[list[PosedCamera], SfmPoints]:
    """The dataset's cameras and points, in its own world."""
    needed = _needed(sources, taken)
    rows = [i for i, name in enumerate(needed) if name in placed]
    found = [placed[needed[i]] for i in rows]
    viewmats = np.tile(np.eye(4), (len(found), 1, 1))
    viewmats[:, :3] = [image.cam_from_world().matrix() for image in found]
    points = points_of(model)
    world: Similarity = world_of(viewmats, points.xyz.astype(np.float64))
    viewmats = world.viewmats(viewmats)
    lens = lenses({image.camera_id: model.cameras[image.camera_id] for image in found})
    names = _names(sources, [taken[i] for i in rows])
    cameras = [
        PosedCamera(
            names[k],
            viewmats[k],
            lens[image.camera_id],
            sources.clips[rows[k]].pictures if sources.fixed else (taken[rows[k]].path,),
        )
        for k, image in enumerate(found)
    ]
    moved = world.points(points.xyz.astype(np.float64)).astype(np.float32)
    return cameras, SfmPoints(moved, points.rgb, points.errors_px, points.n_views)


def _names(sources: Sources, taken: list[Shot]) -> list[str]:
    """Fixed cameras keep their names, photographs those of their files; a.jpg beside a.png becomes a_jpg."""
    if sources.fixed:
        return [shot.name.split("/")[0] for shot in taken]
    stems = [shot.path.stem for shot in taken]
    return [
        shot.path.name.replace(".", "_") if stems.count(stem) > 1 else stem
        for shot, stem in zip(taken, stems, strict=True)
    ]


def _unit_scale(cameras: list[PosedCamera], config: SfmConfig) -> float | None:
    if config.baseline is None:
        return config.unit_scale_m
    *ends, metres = config.baseline
    places = {camera.name: -camera.viewmat[:3, :3].T @ camera.viewmat[:3, 3] for camera in cameras}
    found = []
    for name in ends:
        key = name if name in places else Path(name).stem
        if key not in places:
            known = ", ".join(list(places)[:8])
            raise Tg4mmError(f"--baseline names {name}, which is no placed camera; there are {known} …")
        found.append(places[key])
    apart = float(np.linalg.norm(found[0] - found[1]))
    if apart < 1e-6:
        raise Tg4mmError(f"--baseline: {ends[0]} and {ends[1]} stand at one place")
    return metres / apart


def _report(
    model: Any, taken: list[Shot], placed: dict[str, Any], points: SfmPoints, config: SfmConfig
) -> dict[str, Any]:
    return {
        "pycolmap": colmap("tg4mm sfm").__version__,
        "pictures": len(taken),
        "placed": len(placed),
        "points": len(points),
        "reprojection_error_px": round(float(model.compute_mean_reprojection_error()), 4),
        "camera_model": config.camera_model,
        "seed": config.seed,
        "scale": {"unit_scale_m": config.unit_scale_m, "baseline": config.baseline},
    }
