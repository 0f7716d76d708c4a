"""A capture as other trainers read one: nerfstudio's transforms.json with a time per frame, or a COLMAP text model."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture.frames import frame_of, picture
from tg4mm.capture.model import Capture, SurfacePoints
from tg4mm.capture.points import write_points
from tg4mm.capture.readers import load_capture
from tg4mm.capture.sfm.clip import save_png
from tg4mm.core.errors import CaptureError, MissingSplitError
from tg4mm.core.files import json_digest, link_or_copy, write_atomic, write_json
from tg4mm.core.progress import progress
from tg4mm.core.splatfile.formula import quats_of
from tg4mm.core.work_folder import WorkFolder

POINTS = "points3d.ply"
RECORD = "tg4mm.json"  # in the folder that is written: what it was made of
_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def split_of(dataset: Path, split: str) -> Capture | None:
    """A split of a dataset, None where it has no such split. Raises CaptureError for one that is damaged."""
    try:
        return load_capture(dataset, split)
    except MissingSplitError:
        return None


def at_timesteps(capture: Capture, timesteps: Sequence[int] | None) -> Capture:
    """The images at these timesteps only (None: all). Raises CaptureError for a timestep without images."""
    if timesteps is None:
        return capture
    there = np.unique(capture.timesteps)
    for t in timesteps:
        if t not in there:
            raise CaptureError(
                f"{capture.root}: has no image at timestep {t}; there are {there[0]} … {there[-1]}"
            )
    return capture.selected(np.flatnonzero(np.isin(capture.timesteps, list(timesteps))))


def write_nerfstudio(captures: Sequence[Capture], out: Path) -> Path:
    """Write OUT/transforms.json, OUT/images/ and, where the dataset has points, OUT/points3d.ply.

    `captures`: splits of one dataset. A frame's `time` runs from 0 at the first timestep to 1 at the last, as dynamic
    trainers of that family take it; `time_s` is in seconds, on its camera's own clock. Goes on after a kill. Raises
    CaptureError for an `out` that holds anything else.
    """
    captures = [capture.moved_to(np.zeros(3)) for capture in captures]
    with _owned(out, "nerfstudio", captures):
        return _nerfstudio(captures, out)


def _nerfstudio(captures: Sequence[Capture], out: Path) -> Path:
    last = max(max(capture.n_timesteps for capture in captures) - 1, 1)
    frames, lists = [], {}
    for capture in captures:
        names = link_pictures(capture, out / "images")
        lists[f"{capture.split}_filenames"] = [f"images/{name}" for name in names]
        frames += [_frame(capture, i, f"images/{name}", last) for i, name in enumerate(names)]
    first = captures[0]
    data: dict[str, Any] = {"camera_model": "OPENCV", "w": first.width, "h": first.height}
    if first.fps:
        data["fps"] = first.fps
    data |= lists
    if (points := first.points) is not None:
        write_points(out / POINTS, points)
        data["ply_file_path"] = POINTS
    write_json(out / "transforms.json", {**data, "frames": frames})
    return out


def _frame(capture: Capture, i: int, name: str, last: int) -> dict[str, Any]:
    K, seconds = capture.Ks[i], float(capture.times_s[i])
    pose = np.linalg.inv(capture.viewmats[i]) @ _OPENGL_FROM_OPENCV
    return {
        "file_path": name,
        "transform_matrix": pose.tolist(),
        "time": float(capture.timesteps[i]) / last,
        **({} if np.isnan(seconds) else {"time_s": seconds}),
        "fl_x": float(K[0, 0]),
        "fl_y": float(K[1, 1]),
        "cx": float(K[0, 2]),
        "cy": float(K[1, 2]),
        "w": capture.width,
        "h": capture.height,
    }


def write_colmap(capture: Capture, out: Path) -> Path:
    """Write OUT/sparse/0/{cameras,images,points3D}.txt and OUT/images/.

    Images of all timesteps are in one model, called after their timestep's folder; lenses that are alike are one
    camera. Points have no tracks. Resumable. Raises CaptureError for an `out` that holds anything else.
    """
    capture = capture.moved_to(np.zeros(3))
    with _owned(out, "colmap", [capture]):
        return _colmap(capture, out)


def _colmap(capture: Capture, out: Path) -> Path:
    names = link_pictures(capture, out / "images")
    model = out / "sparse" / "0"
    model.mkdir(parents=True, exist_ok=True)
    lenses: dict[tuple[float, ...], int] = {}
    rows = []
    for i, name in enumerate(names):
        K = capture.Ks[i]
        lens = tuple(float(x) for x in (K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
        camera = lenses.setdefault(lens, len(lenses) + 1)
        viewmat = capture.viewmats[i]
        pose = " ".join(repr(float(x)) for x in (*quaternion(viewmat[:3, :3]), *viewmat[:3, 3]))
        rows.append(f"{i + 1} {pose} {camera} {name}\n\n")  # the second line is of features: none
    size = f"{capture.width} {capture.height}"
    cameras = [f"{n} PINHOLE {size} {' '.join(map(repr, lens))}\n" for lens, n in lenses.items()]
    points = capture.points or SurfacePoints(np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
    spots = [
        f"{i} {x!r} {y!r} {z!r} {r} {g} {b} 0\n"
        for i, ((x, y, z), (r, g, b)) in enumerate(
            zip(points.xyz.astype(float).tolist(), points.rgb.tolist(), strict=True), 1
        )
    ]
    for file, lines in (("points3D", spots), ("cameras", cameras), ("images", rows)):
        write_atomic(model / f"{file}.txt", partial(Path.write_text, data="".join(lines), encoding="utf-8"))
    return out


@contextmanager
def _owned(out: Path, layout: str, captures: Sequence[Capture]) -> Iterator[None]:
    """Hold OUT for this conversion. Raises CaptureError where it holds anything else, RunError while it is in use."""
    pictures = [f"{c.split} {p.relative_to(c.root).as_posix()}" for c in captures for p in c.paths]
    folder = WorkFolder(out, RECORD, CaptureError, others={"pictures": "of other pictures"})
    with folder.locked("writes a dataset there"):
        asked = {"dataset": str(captures[0].root.resolve()), "layout": layout}
        folder.claim({"format": "tg4mm-conversion", "version": 1, **asked, "pictures": json_digest(pictures)})
        yield


def _is_there(source: Path, target: Path) -> bool:
    """Return whether a picture is completely linked or copied: the same file, or one of equal size, not older."""
    if not target.is_file():
        return False
    there, wanted = target.stat(), source.stat()
    return there.st_size == wanted.st_size and there.st_mtime >= wanted.st_mtime


def link_pictures(capture: Capture, folder: Path) -> list[str]:
    """Put the pictures into the folder under their places in the dataset; their names relative to it, "/" between."""
    names = []
    with progress("pictures", len(capture), "pictures", brief=True) as update:
        for done, path in enumerate(capture.paths, 1):
            name, frame = path.relative_to(capture.root), frame_of(path)
            if frame is not None:
                name = name.parent / frame[0].stem / f"{frame[1]:06d}.png"
                if not (folder / name).is_file():
                    (folder / name).parent.mkdir(parents=True, exist_ok=True)
                    save_png(folder / name, picture(path)[..., :3])
            elif capture.lenses and capture.lenses[done - 1] is not None:
                name = name.with_suffix(".png")
                if not (folder / name).is_file():
                    (folder / name).parent.mkdir(parents=True, exist_ok=True)
                    save_png(folder / name, capture.pinhole(done - 1, picture(path)))
            elif not _is_there(path, folder / name):
                link_or_copy(path, folder / name)
            names.append(name.as_posix())
            update(done)
    return names


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """Return [4] unit quaternion wxyz, w ≥ 0, of a rotation matrix [3, 3]."""
    q = quats_of(rotation[None])[0]
    return q if q[0] >= 0 else -q
