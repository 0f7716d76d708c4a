"""The exact motion of a scene at arbitrary points, from its `truth/motion.npz`."""

from __future__ import annotations

import numpy as np

from tg4mm.capture.truth_file import TRUTH_FILE, Truth, TruthObject, load_truth
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.research.evaluate.surface import SurfaceSamples, closest_on_triangles, interpolate, sample_surface

_N_SAMPLES = 200_000  # surface samples of all objects together
_N_CANDIDATES = 8  # triangles tried for the exact nearest point
_N_PATCH = 24  # samples of the patch whose rotation is fitted
_AT_ONCE = 20_000  # points, so that a large scene fits in memory
_FLAT = 0.05  # of the largest variance: a direction with less has no extent, only the surface's curvature


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


__all__ = ["TRUTH_FILE", "Truth", "TruthObject", "exact_motion", "load_truth"]
