"""Conversion between splat objects and Gaussians, and the detection of the up axis."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from tg4mm.core.errors import SplatFileError
from tg4mm.core.splatfile import SplatFile, positions_at, rotations_at
from tg4mm.core.splatfile.formula import transformed
from tg4mm.core.untrusted import read_json

from .. import compat, names
from ..nodes import clock, motion, points, scene
from ..nodes.axes import FILE, MINUS_Y, PLUS_Y, TURNS

CAMERAS = "CAMERAS"
_UPS = {FILE: (0.0, 0.0, 1.0), MINUS_Y: (0.0, -1.0, 0.0), PLUS_Y: (0.0, 1.0, 0.0)}
_NAMES = ("cameras.json", "transforms.json", "transforms_train.json")
_SURE = math.cos(math.radians(45))  # nearer than this only one axis is


def up_axis(path: Path) -> tuple[str, str] | None:
    """Infer the axes from the mean up vector of the cameras; return them with the file used, or None."""
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
    """Return camera files beside the splat file, or above point_cloud/iteration_N, where 3DGS writes them."""
    folders = [path.parent]
    if path.parent.name.startswith("iteration_"):
        folders.append(path.parent.parent.parent)
    for folder in folders:
        yield from (file for name in _NAMES if (file := folder / name).is_file())


def _ups(cameras: Any) -> np.ndarray:
    """Return the pictures' up vectors [C, 3] in the world: 3DGS's cameras.json has y down, NeRF's transforms y up."""
    if isinstance(cameras, list):
        return -np.array([np.array(c["rotation"], float)[:, 1] for c in cameras]).reshape(-1, 3)
    return np.array([np.array(f["transform_matrix"], float)[:3, 1] for f in cameras["frames"]]).reshape(-1, 3)


def splat_of(obj: Any) -> SplatFile:
    """Return the Gaussians of an object with its enabled modes, in world axes and units.

    Apply Transform and the object's own place, turn and scale are in it. Of a sequence the frame that is shown.
    Raises SplatFileError for an object that is scaled to nothing, Tg4mmError for one that lost an attribute.
    """
    frames = scene.sequence_frames(obj)
    mesh = obj.data if frames is None else frames[_shown_frame(obj, len(frames))].data
    whole, world = _of_mesh(obj, mesh), np.array(obj.matrix_world, np.float64)
    # A sequence has its references in the object's own mesh.
    own = points.parts(obj.data)
    found = (
        own
        if frames is None
        else [points.ImportedPart(np.arange(len(whole)), own[0].applied if own else None)]
    )
    turned = [_placed(_rows(whole, part.rows), world, part.applied) for part in found if len(part.rows)]
    return turned[0] if len(turned) == 1 else _joined(turned, np.concatenate([part.rows for part in found]))


def in_axes(splat: SplatFile, axes: str) -> SplatFile:
    """Convert a scene with Z up to another up axis."""
    if axes == FILE:
        return splat
    angle = -TURNS[axes]
    c, s = round(math.cos(angle)), round(math.sin(angle))  # quarter turns
    return transformed(splat, np.array([[1, 0, 0], [0, c, -s], [0, s, c]]))


def now(splat: SplatFile, obj: Any, scene_: Any) -> SplatFile:
    """Return the scene as shown in the current frame, magnification and band included, without modes."""
    if not splat.n_modes:
        return splat
    modifier = scene.splat_modifier(obj)
    alpha, low, high = (compat.get_number(modifier, name) for name in (names.ALPHA, names.LOW, names.HIGH))
    slack = 1e-6 * max(1.0, high)  # as in the node tree
    low, high = max(0.0, low - slack), high + slack
    if low >= high:
        alpha, low, high = 0.0, 0.0, 1.0  # nothing is inside
    t = clock.timestep(scene_, obj, modifier)
    means, quats = (f(splat, t, alpha, (low, high)) for f in (positions_at, rotations_at))
    return without_motion(replace(splat, means=means.astype(np.float32), quats=quats.astype(np.float32)))


def without_motion(splat: SplatFile) -> SplatFile:
    """Return the scene at rest, without modes."""
    rest = (splat.means, splat.quats, splat.scales, splat.opacities, splat.sh)
    still = SplatFile.static(*rest, splat.unit_scale_m)
    return replace(still, low_pass_px2=splat.low_pass_px2, linear=splat.linear)


def _shown_frame(obj: Any, count: int) -> int:
    """Return the index of the file that a sequence shows, computed as in nodes/motion.py."""
    modifier = scene.splat_modifier(obj)
    t = math.floor(clock.timestep(bpy.context.scene, obj, modifier) + motion.SLACK)
    return t % count if compat.get_input(modifier, names.LOOP) else min(max(t, 0), count - 1)


def _of_mesh(obj: Any, mesh: Any) -> SplatFile:
    """Return all Gaussians of a mesh in the axes of their file, with current positions."""
    values: Callable[[str], np.ndarray] = lambda name: points.values(mesh, name)  # noqa: E731
    freqs = [float(f) for f in obj[names.FREQUENCIES]]
    modifier = scene.splat_modifier(obj)
    on = [k for k, name in enumerate(names.toggles(freqs)) if compat.get_input(modifier, name)]
    means = values("position")
    if not len(means):
        raise SplatFileError(f"{obj.name}: no Gaussians are left")
    d, r = (np.empty((len(on), len(means), 3), np.complex64) for _ in range(2))
    for i, k in enumerate(on):
        part = names.phasor(k)
        d[i].real, d[i].imag = values(part["re"]), values(part["im"])
        r[i].real, r[i].imag = values(part["re_r"]), values(part["im_r"])
    has_deviations = bool(on) and all(names.deviation(k) in mesh.attributes for k in on)
    scale, low_pass = obj.get(names.UNIT_SCALE), obj.get(names.LOW_PASS)
    return SplatFile(
        means=means,
        quats=values(names.ROTATION),
        scales=values(names.SCALE),
        opacities=np.clip(values(names.OPACITY), 0.0, 1.0),
        sh=_harmonics(mesh, values),
        freqs_hz=np.array([freqs[k] for k in on], np.float64),
        displacement=d,
        rotation=r,
        fps=float(obj[names.FPS]),
        n_timesteps=int(obj[names.TIMESTEPS]) if freqs else 1,
        unit_scale_m=None if scale is None else float(scale),
        time_origin_s=float(obj.get(names.TIME_ORIGIN, 0.0)),
        deviation=np.array([values(names.deviation(k)) for k in on]) if has_deviations else None,
        low_pass_px2=None if low_pass is None else float(low_pass),
        linear=bool(obj.get(names.LINEAR)),
    )


def _harmonics(mesh: Any, values: Callable[[str], np.ndarray]) -> np.ndarray:
    """Return the spherical harmonics [N, K, 3] as stored in the file."""
    rows = [values(names.NATIVE_BASE)[:, :3]]
    while names.native_sh(len(rows)) in mesh.attributes:
        rows.append(values(names.native_sh(len(rows))))
    return np.stack(rows, axis=1)


def _placed(splat: SplatFile, world: np.ndarray, applied: np.ndarray | None) -> SplatFile:
    """Convert a part to world axes; its positions are in object axes, all else in file axes."""
    linear = world[:3, :3] if applied is None else world[:3, :3] @ applied[:3, :3]
    places = splat.means @ world[:3, :3].T + world[:3, 3]
    return replace(transformed(splat, linear), means=places.astype(np.float32))


def _rows(splat: SplatFile, rows: np.ndarray) -> SplatFile:
    first: dict[str, Any] = {
        name: getattr(splat, name)[rows] for name in ("means", "quats", "scales", "opacities", "sh")
    }
    second: dict[str, Any] = {name: getattr(splat, name)[:, rows] for name in ("displacement", "rotation")}
    deviation = None if splat.deviation is None else splat.deviation[:, rows]
    return replace(splat, **first, **second, deviation=deviation)


def _joined(parts: list[SplatFile], rows: np.ndarray) -> SplatFile:
    """Concatenate parts in mesh order; keep the metric scale only if all parts share it."""
    order = np.argsort(rows, kind="stable")

    def all_of(name: str, axis: int) -> np.ndarray:
        return np.concatenate([getattr(part, name) for part in parts], axis=axis).take(order, axis=axis)

    metres = {part.unit_scale_m for part in parts}
    first: dict[str, Any] = {
        name: all_of(name, 0) for name in ("means", "quats", "scales", "opacities", "sh")
    }
    second: dict[str, Any] = {name: all_of(name, 1) for name in ("displacement", "rotation")}
    deviation = None if parts[0].deviation is None else all_of("deviation", 1)
    return replace(
        parts[0],
        **first,
        **second,
        deviation=deviation,
        unit_scale_m=metres.pop() if len(metres) == 1 else None,
    )
