"""Poses and pictures written as a dataset that the capture readers read (docs/conventions.md)."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from plyfile import PlyData, PlyElement

from tg4mm.capture.decode import decode
from tg4mm.capture.model import SurfacePoints
from tg4mm.errors import CaptureError
from tg4mm.files import write_atomic, write_json
from tg4mm.progress import progress
from tg4mm.sfm.undistort import Lens

_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
COPIED = (".png", ".jpg", ".jpeg")


@dataclass(frozen=True)
class PosedCamera:
    """One camera that stays put, with its pictures: one photograph, or a fixed camera's frames."""

    name: str  # of its pictures in the dataset, without suffix
    viewmat: np.ndarray  # [4, 4] world-to-camera, OpenCV axes
    lens: Lens
    pictures: tuple[Path, ...]  # T


def write_dataset(
    out: Path, cameras: list[PosedCamera], points: SurfacePoints, scene: dict[str, Any], test_every: int = 0
) -> None:
    """A NeRF-synthetic folder where cameras have one picture each, a tree with a folder for each timestep else.

    scene: what scene.json gets. test_every: every so-many-th camera is a test camera, 0 for none. Pictures that are
    there are kept; scene.json comes last and says that all is complete.
    """
    n_timesteps = len(cameras[0].pictures)
    splits = _splits(cameras, test_every)
    folders = [out] if n_timesteps == 1 else [out / f"{t:03d}" for t in range(n_timesteps)]
    with progress("dataset", n_timesteps * len(cameras), "pictures") as update:
        done = 0
        for t, folder in enumerate(folders):
            for split, members in splits.items():
                frames = []
                for frame in _frames(folder, split, members, t):
                    frames.append(frame)
                    done += 1
                    update(done)
                if frames:
                    write_json(folder / f"transforms_{split}.json", {"frames": frames})
    if len(points.xyz):
        write_points(out / "points3d.ply", points)
    width, height = cameras[0].lens.size
    counts = {"n_train": len(splits["train"]), "n_test": len(splits["test"])}
    size = {"width": width, "height": height, "n_timesteps": n_timesteps}
    write_json(out / "scene.json", {"format_version": 1, **scene, **size, **counts})


def _splits(cameras: list[PosedCamera], test_every: int) -> dict[str, list[PosedCamera]]:
    test = [camera for i, camera in enumerate(cameras) if test_every and i % test_every == test_every // 2]
    train = [camera for camera in cameras if camera not in test]
    if len(train) < 2:
        raise CaptureError(
            f"test-every is {test_every}, which leaves {len(train)} of {len(cameras)} cameras to train from"
        )
    return {"train": train, "test": test}


def _frames(folder: Path, split: str, cameras: list[PosedCamera], t: int) -> Iterator[dict[str, Any]]:
    for camera in cameras:
        file = _write_picture(folder / split, camera, camera.pictures[t])
        pose = np.linalg.inv(camera.viewmat) @ _OPENGL_FROM_OPENCV
        K = camera.lens.K
        yield {
            "file_path": f"./{split}/{file}",
            "transform_matrix": pose.tolist(),
            "fl_x": K[0, 0],
            "fl_y": K[1, 1],
            "cx": K[0, 2],
            "cy": K[1, 2],
            "w": camera.lens.size[0],
            "h": camera.lens.size[1],
        }


def _write_picture(folder: Path, camera: PosedCamera, source: Path) -> str:
    """Write the picture unless it is there; a pinhole's is copied byte by byte. Returns its file name."""
    copied = camera.lens.source is None and source.suffix.lower() in COPIED
    target = folder / f"{camera.name}{source.suffix.lower() if copied else '.png'}"
    if target.is_file():
        return target.name
    folder.mkdir(parents=True, exist_ok=True)
    if copied:
        write_atomic(target, lambda temporary: shutil.copyfile(source, temporary))
        return target.name
    image = camera.lens.apply(decode(source))
    opaque = bool((image[..., 3] == 255).all())
    picture = Image.fromarray(image[..., :3] if opaque else image)
    write_atomic(target, lambda temporary: picture.save(temporary, format="PNG", compress_level=3))
    return target.name


def write_points(path: Path, points: SurfacePoints) -> None:
    """points3d.ply, binary: x y z float, red green blue uchar."""
    fields = [*((name, "f4") for name in "xyz"), *((name, "u1") for name in ("red", "green", "blue"))]
    rows = np.zeros(len(points.xyz), dtype=fields)
    for k, (axis, colour) in enumerate(zip("xyz", ("red", "green", "blue"), strict=True)):
        rows[axis], rows[colour] = points.xyz[:, k], points.rgb[:, k]
    data = PlyData([PlyElement.describe(rows, "vertex")])
    write_atomic(path, lambda temporary: data.write(str(temporary)))
