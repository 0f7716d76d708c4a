"""Dataset trees of the phone captures of the fox's room with their true poses: what a perfect SfM would hand over.

    python -m benchmarks fox_phone_sets CAPTURES OUT [--only tripod handheld clips flat] [--sizes full half]

CAPTURES holds tripod/, handheld/, clips/ and truth/; OUT gets tripod, handheld, clips, flat (the tripod's video alone,
its camera at the origin looking along +y) and the same as …_half.
"""

import argparse
import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
from PIL import Image

from tg4mm.capture.model import SurfacePoints
from tg4mm.capture.points import write_points
from tg4mm.core.files import write_json

KINDS = ("tripod", "handheld", "clips", "flat")
SIZES = {
    "full": ("", 1),
    "half": ("_half", 2),
}  # suffix of the folder's name, pixels averaged along each side
N_POINTS = 20_000
# Added to the photographs' positions, scene units: one was taken from the very place of the fixed camera, and the
# reader holds pictures of equal poses for pictures of one camera
APART = 1e-6
# Camera-to-world, OpenCV axes, of a flat capture's camera
FLAT_C2W = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Shot:
    """One picture: where it goes, and from where and when it was taken."""

    timestep: int
    name: str  # of the file, without suffix
    c2w: np.ndarray  # [4, 4] camera-to-world, OpenCV axes
    time_s: float | None  # None for a photograph of the still scene
    picture: np.ndarray  # [H, W, 3] uint8


def frames_of(video: Path) -> Iterator[np.ndarray]:
    """The frames of a video, [H, W, 3] uint8."""
    frames = imageio_ffmpeg.read_frames(str(video))
    width, height = next(frames)["size"]
    for data in frames:
        yield np.frombuffer(data, np.uint8).reshape(height, width, 3)


def sweep(captures: Path, truth: dict[str, Any]) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Name, camera-to-world and picture of the photographs of the still scene; a name is the camera's index."""
    files = sorted((captures / "tripod" / "sweep").glob("*.jpg"))
    poses = np.array(truth["cams_sweep"])
    return [(file.stem, poses[int(file.stem)], np.asarray(Image.open(file).convert("RGB"))) for file in files]


def shots(captures: Path, truth: dict[str, Any], kind: str) -> Iterator[Shot]:
    """All pictures of one capture, in order of video, then time."""
    fps = truth["fps"]
    if kind == "flat":
        for t, picture in enumerate(frames_of(captures / "tripod" / "cam_00.mp4")):
            yield Shot(t, "cam_00", FLAT_C2W, t / fps, picture)
    elif kind == "tripod":
        for name, c2w, picture in sweep(captures, truth):
            apart = c2w.copy()
            apart[:3, 3] += APART
            yield Shot(0, f"sweep_{name}", apart, None, picture)
        for t, picture in enumerate(frames_of(captures / "tripod" / "cam_00.mp4")):
            yield Shot(t, "cam_00", np.array(truth["c2w_fixed"]), t / fps, picture)
    elif kind == "handheld":
        for t, picture in enumerate(frames_of(captures / "handheld" / "video.mp4")):
            yield Shot(t, "cam_00", np.array(truth["hand"][t]), t / fps, picture)
    else:
        for c, camera in enumerate(truth["clips"]["cams"]):
            for t, picture in enumerate(frames_of(captures / "clips" / f"cam_{c:02d}.mp4")):
                yield Shot(t, f"cam_{c:02d}", np.array(truth["cams_sweep"][camera]), t / fps, picture)


def averaged(picture: np.ndarray, side: int) -> np.ndarray:
    """Means over `side` × `side` pixels of [H, W, 3] uint8, rounded. H and W must be divisible by `side`."""
    height, width, channels = picture.shape
    blocks = picture.reshape(height // side, side, width // side, side, channels)
    return np.rint(blocks.mean((1, 3), dtype=np.float32)).astype(np.uint8)


def frame_record(shot: Shot, K: np.ndarray, size: tuple[int, int]) -> dict[str, Any]:
    """A frame as transforms_train.json has it. K in pixels of a picture of this size (width, height)."""
    record = {
        "file_path": f"./train/{shot.name}.png",
        "transform_matrix": (shot.c2w @ OPENGL_FROM_OPENCV).tolist(),
        "fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], "w": size[0], "h": size[1],
    }  # fmt: skip
    return record if shot.time_s is None else record | {"time": shot.time_s}


def flat_intrinsics(size: tuple[int, int]) -> np.ndarray:
    """[3, 3] of a camera of which nothing is known: as long as the picture's longer side (width, height)."""
    f = float(max(size))
    return np.array([[f, 0, size[0] / 2], [0, f, size[1] / 2], [0, 0, 1]])


def write_set(out: Path, captures: Path, truth: dict[str, Any], kind: str, side: int) -> None:
    """One dataset tree; scene.json comes last."""
    size = truth["W"] // side, truth["H"] // side
    K = flat_intrinsics(size) if kind == "flat" else np.array(truth["K"]) / [[side], [side], [1]]
    frames: dict[int, list[dict[str, Any]]] = {}
    with ThreadPoolExecutor(2) as pool:
        saved = []
        for shot in shots(captures, truth, kind):
            file = out / f"{shot.timestep:03d}" / "train" / f"{shot.name}.png"
            file.parent.mkdir(parents=True, exist_ok=True)
            saved.append(pool.submit(_save, file, shot.picture, side))
            frames.setdefault(shot.timestep, []).append(frame_record(shot, K, size))
        for done in saved:
            done.result()  # raises what saving raised
    for t, records in frames.items():
        write_json(out / f"{t:03d}" / "transforms_train.json", {"frames": records})
    if kind != "flat":
        write_points(out / "points3d.ply", surface_points(captures, truth))
    scene = {"kind": kind, "fps": truth["fps"], "n_timesteps": len(frames), "background": "as photographed"}
    write_json(out / "scene.json", {"format_version": 1, **scene})


def _save(file: Path, picture: np.ndarray, side: int) -> None:
    Image.fromarray(averaged(picture, side)).save(file, compress_level=1)


def project(xyz: np.ndarray, c2w: np.ndarray, K: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixel coordinates [N, 2] (centres at +0.5) and depths [N] of points [N, 3]; c2w has OpenCV axes."""
    in_camera = (xyz - c2w[:3, 3]) @ c2w[:3, :3]
    depth = in_camera[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        return (in_camera @ K.T)[:, :2] / depth[:, None], depth


def visible(uv: np.ndarray, depth: np.ndarray, size: tuple[int, int], cell: int = 6) -> np.ndarray:
    """[N] whether a point lies in the picture and within 3 % of the nearest depth among points in its cell.

    size: width, height; cell: side in pixels.
    """
    inside = (depth > 0.05) & (uv >= 0).all(1) & (uv < np.array(size)).all(1)
    columns = -(-size[0] // cell)
    index = np.zeros(len(uv), np.int64)
    index[inside] = (uv[inside, 1] // cell).astype(int) * columns + (uv[inside, 0] // cell).astype(int)
    nearest = np.full(columns * (-(-size[1] // cell)), np.inf)
    np.minimum.at(nearest, index[inside], depth[inside])
    return inside & (depth <= 1.03 * nearest[index])


def surface_points(captures: Path, truth: dict[str, Any]) -> SurfacePoints:
    """A random subset of the truth's means, coloured from the first photograph that sees each; grey if none does."""
    with np.load(captures / "truth" / "gauss.npz") as gauss:
        xyz = gauss["means"][gauss["opacities"] > 0.3]
    rgb = np.full((len(xyz), 3), 128, np.uint8)
    coloured = np.zeros(len(xyz), bool)
    for _, c2w, picture in sweep(captures, truth):
        uv, depth = project(xyz, c2w, np.array(truth["K"]))
        seen = visible(uv, depth, (truth["W"], truth["H"])) & ~coloured
        u, v = uv[seen].astype(int).T
        rgb[seen] = picture[v, u]
        coloured |= seen
    candidates = np.flatnonzero(coloured)
    chosen = np.random.default_rng(0).choice(candidates, min(N_POINTS, len(candidates)), replace=False)
    return SurfacePoints(xyz[chosen].astype(np.float32), rgb[chosen])


OPTIONS = {
    "captures": Path,
    "out": Path,
    "--only": {"nargs": "+", "choices": KINDS, "default": KINDS},
    "--sizes": {"nargs": "+", "choices": sorted(SIZES), "default": ("half", "full")},
}


def run(options: argparse.Namespace) -> None:
    """Write the sets that are asked for and are not there yet; OUT/ready.txt has a line for each."""
    truth = json.loads((options.captures / "truth" / "truth.json").read_text())
    for size in options.sizes:
        suffix, side = SIZES[size]
        for kind in options.only:
            out = options.out / f"{kind}{suffix}"
            if not (out / "scene.json").is_file():
                write_set(out, options.captures, truth, kind, side)
                with (options.out / "ready.txt").open("a") as ready:
                    ready.write(f"{out.name}\n")
