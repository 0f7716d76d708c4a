"""Which way is up in a splat file: what the file of cameras beside it says."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core.untrusted import read_json

FILE, MINUS_Y, PLUS_Y, CAMERAS = "FILE", "MINUS_Y", "PLUS_Y", "CAMERAS"
# About x, radians: what turns this up into Blender's.
TURNS = {FILE: 0.0, MINUS_Y: -math.pi / 2, PLUS_Y: math.pi / 2}
LABELS = {FILE: "Z up", MINUS_Y: "−Y up", PLUS_Y: "Y up"}
_UPS = {FILE: (0.0, 0.0, 1.0), MINUS_Y: (0.0, -1.0, 0.0), PLUS_Y: (0.0, 1.0, 0.0)}
_NAMES = ("cameras.json", "transforms.json", "transforms_train.json")
_SURE = math.cos(math.radians(45))  # nearer than this only one axis is


def told(path: Path) -> tuple[str, str] | None:
    """The axes by the cameras' mean up, and the file that says so; None where none is there or it is undecided."""
    for file in _beside(path):
        try:
            ups = _ups(read_json(file))
        except (OSError, ValueError, TypeError, KeyError, IndexError):
            continue  # of another program, by that name
        mean = ups.sum(axis=0)
        mean /= float(np.linalg.norm(mean)) or 1.0
        axes = max(_UPS, key=lambda axes: float(np.dot(mean, _UPS[axes])))
        return (axes, file.name) if float(np.dot(mean, _UPS[axes])) > _SURE else None
    return None


def _beside(path: Path) -> Iterator[Path]:
    """Files of cameras in the splat file's folder; of point_cloud/iteration_N, where 3DGS writes, in that above."""
    folders = [path.parent]
    if path.parent.name.startswith("iteration_"):
        folders.append(path.parent.parent.parent)
    for folder in folders:
        yield from (file for name in _NAMES if (file := folder / name).is_file())


def _ups(cameras: Any) -> np.ndarray:
    """[C, 3] where up in the pictures is in the world: of 3DGS's cameras.json, y down, or NeRF's transforms, y up."""
    if isinstance(cameras, list):
        return -np.array([np.array(c["rotation"], float)[:, 1] for c in cameras]).reshape(-1, 3)
    return np.array([np.array(f["transform_matrix"], float)[:3, 1] for f in cameras["frames"]]).reshape(-1, 3)
