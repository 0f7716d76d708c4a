"""points3d.ply and its like, read and written: points on the surfaces with colours."""

from pathlib import Path

import numpy as np
from plyfile import PlyData, PlyElement

from tg4mm.capture.cameras import FAR
from tg4mm.capture.frames import inside
from tg4mm.capture.model import SurfacePoints
from tg4mm.core.errors import CaptureError
from tg4mm.core.files import write_atomic

GREY = 128  # the colour of points that come without one


def read_points(root: Path, name: str = "points3d.ply") -> SurfacePoints | None:
    """root/<name>, None if absent. ASCII or binary; x y z, red green blue as uchar (else grey)."""
    path = inside(root, root / name, name)
    if not path.is_file():
        return None
    vertex = _vertices(path)
    xyz = np.stack([_column(path, vertex, name) for name in "xyz"], axis=1)
    if not np.isfinite(xyz).all():
        bad = int(np.flatnonzero(~np.isfinite(xyz).all(axis=1))[0])
        raise CaptureError(f"{path}: point {bad} is {xyz[bad].tolist()}; expected finite coordinates")
    return SurfacePoints(
        xyz.astype(np.float64 if xyz.dtype == np.float64 else np.float32), _colours(path, vertex)
    )


def write_points(path: Path, points: SurfacePoints) -> None:
    """points3d.ply, binary: x y z float, double far from the origin, where float holds no places; colours uchar."""
    extent = np.ptp(points.xyz, axis=0).max() if len(points.xyz) else 0.0
    far = np.abs(points.xyz).max(initial=0) > FAR * extent > 0
    fields = [
        *((name, "f8" if far else "f4") for name in "xyz"),
        *((name, "u1") for name in ("red", "green", "blue")),
    ]
    rows = np.zeros(len(points.xyz), dtype=fields)
    for k, (axis, colour) in enumerate(zip("xyz", ("red", "green", "blue"), strict=True)):
        rows[axis], rows[colour] = points.xyz[:, k], points.rgb[:, k]
    data = PlyData([PlyElement.describe(rows, "vertex")])
    write_atomic(path, lambda temporary: data.write(str(temporary)))


def _vertices(path: Path) -> PlyElement:
    try:
        vertex = PlyData.read(path)["vertex"]
    except KeyError as error:
        raise CaptureError(f"{path}: has no vertex element") from error
    # plyfile reports malformed files by many types (PlyParseError, ValueError, MemoryError …)
    except Exception as error:
        raise CaptureError(f"{path}: is not a readable PLY: {' '.join(str(error).split())}") from error
    if vertex.count == 0:
        raise CaptureError(f"{path}: holds 0 points")
    return vertex


def _column(path: Path, vertex: PlyElement, name: str) -> np.ndarray:
    if name not in vertex.data.dtype.names:
        raise CaptureError(
            f"{path}: property {name} is missing; there is {', '.join(vertex.data.dtype.names)}"
        )
    column = vertex.data[name]
    if column.dtype.kind not in "fiu":
        raise CaptureError(f"{path}: property {name} is a list; expected one number")
    return column


def _colours(path: Path, vertex: PlyElement) -> np.ndarray:
    names = ("red", "green", "blue")
    if not any(name in vertex.data.dtype.names for name in names):
        return np.full((vertex.count, 3), GREY, dtype=np.uint8)
    columns = [_column(path, vertex, name) for name in names]
    for name, column in zip(names, columns, strict=True):
        if column.dtype != np.uint8:
            raise CaptureError(f"{path}: property {name} is {column.dtype}; expected uchar, 0 to 255")
    return np.stack(columns, axis=1)
