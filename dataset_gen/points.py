"""points3d.ply: points spread evenly over the surfaces that cameras see, with the colours they see."""

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tg4mm.core.untrusted import read_npz

from . import tree
from .meshes import triangle_areas
from .plan import Shot
from .settings import Settings
from .vibration import Body

FILE = "points3d.ply"
_ROW = 27  # bytes of a point: six float32 and three uint8
FOLDER = ".points"  # working folder: the colours that training views give
_SPARE = 4  # candidates per wanted point: surfaces inside others are seen by no camera and drop out


@dataclass(frozen=True)
class PointCandidates:
    """Points on the surfaces of a scene at rest."""

    positions: np.ndarray  # [P, 3] float64, world
    normals: np.ndarray  # [P, 3] float64, of the triangle


def sample_surfaces(bodies: Sequence[Body], count: int, seed: int) -> PointCandidates:
    """`count` · 4 points, uniform over the area of all bodies, in random order."""
    rng = np.random.default_rng([seed, 1])
    areas = [triangle_areas(body.vertices, body.triangles) for body in bodies]
    corners = np.concatenate([body.vertices[body.triangles] for body in bodies])
    weight = np.concatenate(areas)
    picked = corners[rng.choice(len(corners), size=_SPARE * count, p=weight / weight.sum())]
    a, b = rng.random((2, len(picked)))
    a, b = np.where(a + b > 1, 1 - a, a), np.where(a + b > 1, 1 - b, b)
    edges = picked[:, 1] - picked[:, 0], picked[:, 2] - picked[:, 0]
    normals = np.cross(*edges)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return PointCandidates(picked[:, 0] + a[:, None] * edges[0] + b[:, None] * edges[1], normals)


def wanted(root: Path, settings: Settings) -> bool:
    """Return whether points3d.ply is requested and not yet complete."""
    if not settings.points:
        return False
    try:
        data = (root / FILE).read_bytes()
    except OSError:
        return True
    header, _, rows = data.partition(b"end_header\n")
    found = re.search(rb"element vertex (\d+)", header)
    return found is None or int(found[1]) < 1 or len(rows) != int(found[1]) * _ROW


def view_file(root: Path, shot: Shot) -> Path:
    """File of the colours that a training view gives to the points."""
    return root / FOLDER / f"{shot.camera.name}_{shot.pictures[0].timestep:03d}.npz"


def read_view(file: Path, count: int) -> dict[str, np.ndarray]:
    """The colours that a view gives to candidates for `count` points. Raises ValueError for other content."""
    view = read_npz(file)
    index, colour, weight = (view.get(name) for name in ("index", "colour", "weight"))
    if index is None or colour is None or weight is None or index.ndim != 1 or index.dtype.kind not in "iu":
        raise ValueError("its arrays are not a view's points and colours")
    if (
        colour.shape != (len(index), 3)
        or weight.shape != index.shape
        or colour.dtype.kind + weight.dtype.kind != "ff"
    ):
        raise ValueError("its arrays have different lengths")
    if len(index) and (index.min() < 0 or index.max() >= _SPARE * count):
        raise ValueError("a point number is out of range")
    if not (np.isfinite(colour).all() and np.isfinite(weight).all()):
        raise ValueError("a value is not finite")
    return view


def merge(views: list[dict[str, np.ndarray]], count: int) -> tuple[np.ndarray, np.ndarray]:
    """The first `count` points that any view saw (their numbers) and their mean colours [P, 3] in 0..1."""
    if not views:
        return np.zeros(0, np.int64), np.zeros((0, 3))
    index = np.concatenate([view["index"] for view in views])
    weight = np.concatenate([view["weight"] for view in views])
    colour = np.concatenate([view["colour"] for view in views])
    total = np.bincount(index, weight)
    seen = np.flatnonzero(total > 0)[:count]
    mean = np.column_stack([np.bincount(index, weight * colour[:, k]) for k in range(3)])
    return seen, mean[seen] / total[seen, None]


def write_ply(path: Path, positions: np.ndarray, normals: np.ndarray, colours: np.ndarray) -> None:
    """Binary little-endian PLY: x y z nx ny nz float32, red green blue uint8; colours [P, 3] sRGB in 0..1."""
    fields = [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
    fields += [(name, "u1") for name in ("red", "green", "blue")]
    rows = np.zeros(len(positions), fields)
    for k in range(3):
        rows["xyz"[k]] = positions[:, k]
        rows["n" + "xyz"[k]] = normals[:, k]
        rows[("red", "green", "blue")[k]] = np.round(np.clip(colours[:, k], 0, 1) * 255)
    kinds = {"<f4": "float", "u1": "uchar"}
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    header += [f"property {kinds[kind]} {name}" for name, kind in fields]
    out = io.BytesIO()
    out.write(("\n".join([*header, "end_header"]) + "\n").encode("ascii"))
    out.write(rows.tobytes())
    tree.write_bytes(path, out.getvalue())
