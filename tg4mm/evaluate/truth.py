"""The exact motion of a scene at arbitrary points, from its `truth/motion.npz`."""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.errors import CaptureError
from tg4mm.evaluate.surface import SurfaceSamples, closest_on_triangles, interpolate, sample_surface
from tg4mm.motion.modes import ModalMotion

TRUTH_FILE = Path("truth") / "motion.npz"
_N_SAMPLES = 200_000  # surface samples of all objects together
_N_CANDIDATES = 8  # triangles tried for the exact nearest point
_N_PATCH = 24  # samples of the patch whose rotation is fitted
_AT_ONCE = 20_000  # points, so that a large scene fits in memory
_SAME_GAIN = 1e-6  # gains nearer than this to the exponentials are those, stored in single precision
_FLAT = 0.05  # of the largest variance: a direction with less has no extent, only the surface's curvature


@dataclass(frozen=True)
class TruthObject:
    """One object's mesh at rest and its exact motion, zero if it stands still."""

    name: str
    rest: np.ndarray  # [V, 3] float64, world space, scene units
    faces: np.ndarray  # [F, 3] int64
    modes: np.ndarray  # [K, V, 3] complex128, displacement phasors, scene units


@dataclass(frozen=True)
class Truth:
    """Displacement of vertex v at timestep t: Re Σ_k (1 + α magnified[k]) modes[k, v] gains[k, t].

    The gains are exp(i 2π f_k t / fps) unless a mode rings down or drifts.
    """

    freqs_hz: np.ndarray  # [K] float64
    objects: tuple[TruthObject, ...]
    fps: float  # Hz
    n_timesteps: int
    gains: np.ndarray | None = None  # [K, T] complex128; None: the exponentials
    magnified: np.ndarray | None = None  # [K] bool; None: all


def load_truth(root: Path, fps: float, n_timesteps: int) -> Truth:
    """Read `<root>/truth/motion.npz` (docs/conventions.md) of a dataset of `n_timesteps` at `fps`, without pickles.

    `gains` and `magnified` may be absent: then every mode is a sinusoid and magnified.

    Raises CaptureError naming the file and what is wrong with it: absent, torn, an array that is missing, of
    a wrong shape or not finite, a face that points past the vertices.
    """
    file = Path(root) / TRUTH_FILE
    if not file.is_file():
        raise CaptureError(f"{file} does not exist")
    if not file.resolve().is_relative_to(Path(root).resolve()):
        raise CaptureError(f"{file} leads out of the dataset's folder, to {file.resolve()}")
    try:
        with np.load(file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except (
        OSError,
        TypeError,
        ValueError,
        EOFError,
        AttributeError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise CaptureError(f"{file} is torn or not an .npz of plain arrays: {_one_line(error)}") from None
    freqs = _array(file, arrays, "frequencies_hz", (None,), np.floating).astype(np.float64)
    if (freqs < 0).any():
        raise CaptureError(f"{file}: frequencies_hz holds {freqs.min():g} Hz, expected ≥ 0")
    names = _array(file, arrays, "objects", (None,), np.str_)
    objects = tuple(_object(file, arrays, i, str(name), len(freqs)) for i, name in enumerate(names))
    if not objects:
        raise CaptureError(f"{file}: objects is empty")
    gains, magnified = _time_laws(file, arrays, freqs, fps, n_timesteps)
    return Truth(freqs, objects, fps, n_timesteps, gains, magnified)


def _time_laws(
    file: Path, arrays: dict[str, np.ndarray], freqs: np.ndarray, fps: float, n_timesteps: int
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """(gains, magnified), None where they say no more than the frequencies do."""
    gains = magnified = None
    if "gains" in arrays:
        shape = (len(freqs), n_timesteps)
        gains = _array(file, arrays, "gains", shape, np.complexfloating).astype(np.complex128)
        plain = np.exp(2j * np.pi * np.outer(freqs, np.arange(n_timesteps)) / (fps or 1.0))
        gains = None if np.abs(gains - plain).max(initial=0.0) < _SAME_GAIN else gains
    if "magnified" in arrays:
        magnified = _array(file, arrays, "magnified", (len(freqs),), np.bool_)
        magnified = None if magnified.all() else magnified
    return gains, magnified


def _object(file: Path, arrays: dict[str, np.ndarray], i: int, name: str, n_modes: int) -> TruthObject:
    rest = _array(file, arrays, f"rest_{i}", (None, 3), np.floating).astype(np.float64)
    faces = _array(file, arrays, f"faces_{i}", (None, 3), np.integer).astype(np.int64)
    modes = _array(file, arrays, f"mode_{i}", (n_modes, len(rest), 3), np.complexfloating).astype(
        np.complex128
    )
    if faces.size and not 0 <= faces.min() <= faces.max() < len(rest):
        span = f"{faces.min()} to {faces.max()}, expected 0 to {len(rest) - 1}"
        raise CaptureError(f"{file}: faces_{i} ({name}) has vertices {span}")
    return TruthObject(name, rest, faces, modes)


def _array(
    file: Path, arrays: dict[str, np.ndarray], key: str, shape: tuple[int | None, ...], kind: Any
) -> np.ndarray:
    if key not in arrays:
        raise CaptureError(f"{file} has no {key}")
    array = arrays[key]
    fits = len(array.shape) == len(shape) and all(
        s is None or s == a for s, a in zip(shape, array.shape, strict=True)
    )
    if not fits:
        wanted = tuple("any" if s is None else s for s in shape)
        raise CaptureError(f"{file}: {key} has shape {array.shape}, expected {wanted}")
    if not np.issubdtype(array.dtype, kind):
        raise CaptureError(f"{file}: {key} has type {array.dtype}, expected {kind.__name__}")
    if np.issubdtype(kind, np.inexact) and not np.isfinite(array).all():
        raise CaptureError(f"{file}: {key} holds a value that is not finite")
    return array


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:160] or type(error).__name__


def exact_motion(truth: Truth, points: np.ndarray) -> ModalMotion:
    """The exact modal motion of `points` [N, 3] (scene units, at rest), e.g. the means of Gaussians.

    A point moves as the nearest point of any object's surface does (piecewise-linear between vertices): its
    displacement is interpolated there. Its rotation is half the curl (the antisymmetric part) of the
    displacement gradient that fits the surrounding samples best, in the sense of least squares. Along the
    normal of a flat patch no sample shows a gradient: there the normal is taken to stay perpendicular to the
    surface (Kirchhoff), so that a plate that tilts by ω turns by ω and not by half of it. Objects that stand
    still give zeros. Raises ValueError for a wrong shape.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points have shape {points.shape}, expected [N, 3]")
    objects = [o for o in truth.objects if len(o.rest)]
    displacement = np.zeros((len(truth.freqs_hz), len(points), 3), dtype=np.complex128)
    rotation = np.zeros_like(displacement)
    surfaces = [sample_surface(o.rest, o.faces, _N_SAMPLES // len(objects)) for o in objects]
    if surfaces and len(points):
        distance = np.stack([s.tree.query(points, workers=-1)[0] for s in surfaces])
        nearest = distance.argmin(0)
        for i, (obj, surface) in enumerate(zip(objects, surfaces, strict=True)):
            mine = np.flatnonzero(nearest == i)
            for part in np.split(mine, range(_AT_ONCE, len(mine), _AT_ONCE)) if obj.modes.any() else ():
                displacement[:, part], rotation[:, part] = _follow(obj, surface, points[part])
    return ModalMotion(
        truth.freqs_hz,
        displacement.astype(np.complex64),
        rotation.astype(np.complex64),
        truth.fps,
        truth.n_timesteps,
        truth.gains,
        truth.magnified,
    )


def _follow(obj: TruthObject, surface: SurfaceSamples, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(displacement, rotation) phasors [K, n, 3] of the points of an object's surface nearest to `points`."""
    k = min(_N_CANDIDATES, len(surface.points))
    _, candidates = surface.tree.query(points, k=k, workers=-1)
    triangles = surface.triangles[candidates.reshape(len(points), k)]  # [n, k, 3]
    corners = obj.rest[triangles].reshape(-1, 3, 3)
    barycentric, distance = closest_on_triangles(np.repeat(points, k, 0), corners)
    best = distance.reshape(len(points), k).argmin(1)
    rows = np.arange(len(points))
    foot = triangles[rows, best], barycentric.reshape(len(points), k, 3)[rows, best]
    n_patch = min(_N_PATCH, len(surface.points))
    _, patch = surface.tree.query(interpolate(obj.rest, *foot), k=n_patch, workers=-1)
    patch = patch.reshape(len(points), n_patch)
    rotation = _rotation(surface.points[patch], surface.interpolate(obj.modes, patch))
    return interpolate(obj.modes, *foot), rotation


def _rotation(x: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Rotation phasors [K, n, 3] of patches x [n, S, 3] displaced by d [K, n, S, 3]: see `exact_motion`."""
    r, e = x - x.mean(1, keepdims=True), d - d.mean(2, keepdims=True)
    extent, axes = np.linalg.eigh(np.einsum("nsi,nsj->nij", r, r))
    seen = extent > _FLAT * extent[:, -1:]  # [n, 3], directions along which the patch has extent
    inverse = np.einsum("nia,na,nja->nij", axes, np.where(seen, 1.0 / np.where(seen, extent, 1.0), 0.0), axes)
    gradient = np.einsum("knsi,nsl,nlj->knij", e, r, inverse)  # d ≈ d̄ + gradient · r
    along = np.einsum("nia,na,nja->nij", axes, seen.astype(float), axes)
    # What the patch does not show: its normal stays perpendicular, ∂u/∂n = −∇(u · n) along the surface.
    gradient -= np.einsum("nil,knml,nmj->knij", along, gradient, np.eye(3) - along)
    curl = [gradient[..., j, i] - gradient[..., i, j] for i, j in ((1, 2), (2, 0), (0, 1))]
    return 0.5 * np.stack(curl, -1)
