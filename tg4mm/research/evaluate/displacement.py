"""Errors of an estimated motion against the true one: displacement, direction, leak."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from tg4mm.capture.truth_file import Truth, TruthObject
from tg4mm.fit.motion.modes import ModalMotion

_N_SAMPLES = 200_000  # surface samples of all objects together
_N_CANDIDATES = 8  # triangles tried for the exact nearest point
_N_PATCH = 24  # samples of the patch whose rotation is fitted
_AT_ONCE = 20_000  # points, so that a large scene fits in memory
_FLAT = 0.05  # of the largest variance; a direction with less has only the surface's curvature
STATIC_BELOW = 0.01  # of the largest true motion; a Gaussian with less counts as static


def exact_motion(truth: Truth, points: np.ndarray) -> ModalMotion:
    """Return the exact modal motion of `points` [N, 3] (scene units, at rest), e.g. the means of Gaussians.

    A point moves like the nearest point of any object's surface (piecewise-linear between vertices), where its
    displacement is interpolated. Its rotation is half the curl (the antisymmetric part) of the displacement gradient
    that fits the surrounding samples in least squares. No sample shows a gradient along the normal of a flat patch;
    the normal is assumed to stay perpendicular to the surface (Kirchhoff), so that a plate that tilts by ω turns by ω
    and not by half of it. Static objects give zeros. Raises ValueError for a wrong shape.
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
    return ModalMotion.of_phasors(
        truth.freqs_hz,
        displacement.astype(np.complex64),
        rotation.astype(np.complex64),
        truth.fps,
        truth.n_timesteps,
        truth.gains,
        truth.magnified,
    )


def _follow(obj: TruthObject, surface: "SurfaceSamples", points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return phasors of displacement and rotation, [K, n, 3] each, of the surface points nearest to `points`."""
    *foot, _ = nearest_on(surface, obj.rest, points, _N_CANDIDATES)
    n_patch = min(_N_PATCH, len(surface.points))
    _, patch = surface.tree.query(interpolate(obj.rest, *foot), k=n_patch, workers=-1)
    patch = patch.reshape(len(points), n_patch)
    rotation = _rotation(surface.points[patch], surface.interpolate(obj.modes, patch))
    return interpolate(obj.modes, *foot), rotation


def nearest_on(
    surface: "SurfaceSamples", vertices: np.ndarray, points: np.ndarray, n_candidates: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the surface points nearest to points [n, 3] on the triangles of the `n_candidates` nearest samples.

    Returns their triangles' vertex indices [n, 3], barycentric coordinates [n, 3] and distances [n].
    """
    k = min(n_candidates, len(surface.points))
    candidates = surface.tree.query(points, k=k, workers=-1)[1].reshape(len(points), k)
    triangles = surface.triangles[candidates]  # [n, k, 3]
    corners = vertices[triangles].reshape(-1, 3, 3)
    barycentric, distance = closest_on_triangles(np.repeat(points, k, 0), corners)
    distance, rows = distance.reshape(len(points), k), np.arange(len(points))
    best = distance.argmin(1)
    return triangles[rows, best], barycentric.reshape(len(points), k, 3)[rows, best], distance[rows, best]


def _rotation(x: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return rotation phasors [K, n, 3] of patches x [n, S, 3] displaced by d [K, n, S, 3], as in `exact_motion`."""
    r, e = x - x.mean(1, keepdims=True), d - d.mean(2, keepdims=True)
    extent, axes = np.linalg.eigh(np.einsum("nsi,nsj->nij", r, r))
    seen = extent > _FLAT * extent[:, -1:]  # [n, 3], directions along which the patch has extent
    inverse = np.einsum("nia,na,nja->nij", axes, np.where(seen, 1.0 / np.where(seen, extent, 1.0), 0.0), axes)
    gradient = np.einsum("knsi,nsl,nlj->knij", e, r, inverse)  # d ≈ d̄ + gradient · r
    along = np.einsum("nia,na,nja->nij", axes, seen.astype(float), axes)
    # The normal stays perpendicular to the surface: ∂u/∂n = −∇(u · n) along it.
    gradient -= np.einsum("nil,knml,nmj->knij", along, gradient, np.eye(3) - along)
    curl = [gradient[..., j, i] - gradient[..., i, j] for i, j in ((1, 2), (2, 0), (0, 1))]
    return 0.5 * np.stack(curl, -1)


@dataclass(frozen=True)
class SurfaceSamples:
    """Points spread over a triangle mesh, each with its triangle and barycentric coordinates."""

    points: np.ndarray  # [S, 3] float64, scene units
    triangles: np.ndarray  # [S, 3] int64, vertex indices
    barycentric: np.ndarray  # [S, 3] float64, sum 1
    tree: cKDTree

    def interpolate(self, values: np.ndarray, which: np.ndarray) -> np.ndarray:
        """Interpolate vertex values [..., V, D] at the samples `which` [...samples] to [..., *samples, D]."""
        return interpolate(values, self.triangles[which], self.barycentric[which])


def interpolate(values: np.ndarray, triangles: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
    """Interpolate vertex values [..., V, D] at points of triangles by barycentric coordinates, both [*, 3]."""
    return (values[..., triangles, :] * barycentric[..., None]).sum(axis=-2)


def sample_surface(vertices: np.ndarray, faces: np.ndarray, n_samples: int) -> SurfaceSamples:
    """Return every vertex, every triangle's centre, and about `n_samples` more points in proportion to area.

    Points within a triangle follow the R2 low-discrepancy sequence (Roberts 2018), folded from the square to the
    triangle, and are always the same. A vertex of no triangle becomes a degenerate triangle.
    """
    loose = np.setdiff1d(np.arange(len(vertices)), faces)
    faces = np.concatenate([faces.reshape(-1, 3), np.repeat(loose[:, None], 3, axis=1)]).astype(np.int64)
    corners = vertices[faces]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    share = area / area.sum() if area.sum() > 0 else np.zeros(len(area))
    counts = 1 + np.floor(share * n_samples).astype(np.int64)
    face_of = np.repeat(np.arange(len(faces)), counts)
    nth = np.arange(len(face_of)) - np.repeat(np.cumsum(counts) - counts, counts)
    # One corner represents each vertex: its first use.
    _, first = np.unique(faces.ravel(), return_index=True)
    face_of = np.concatenate([face_of, first // 3])
    barycentric = np.concatenate([_folded_r2(nth), np.eye(3)[first % 3]])
    triangles = faces[face_of]
    points = interpolate(vertices, triangles, barycentric)
    return SurfaceSamples(points, triangles, barycentric, cKDTree(points))


def _folded_r2(nth: np.ndarray) -> np.ndarray:
    """Return barycentric coordinates [n, 3] of the nth point in a triangle; point 0 is the centre."""
    plastic = 1.32471795724474602596  # the root of x³ = x + 1
    u, v = (1 / 3 + nth / plastic) % 1.0, (1 / 3 + nth / plastic**2) % 1.0
    over = u + v > 1.0
    u, v = np.where(over, 1.0 - u, u), np.where(over, 1.0 - v, v)
    return np.stack([1.0 - u - v, u, v], axis=1)


def closest_on_triangles(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return barycentric coordinates [n, 3] and distance [n] of triangle i's [n, 3, 3] closest point to point i [n, 3].

    It is the foot of the perpendicular if that lies inside, otherwise the closest point of the three edges, as for
    degenerate triangles.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    candidates = [_foot(points, a, b, c)]
    for i, j in ((0, 1), (1, 2), (2, 0)):
        start, edge = corners[:, i], corners[:, j] - corners[:, i]
        length2 = (edge * edge).sum(1)
        s = ((points - start) * edge).sum(1) / np.where(length2 > 0, length2, 1.0)
        barycentric = np.zeros((len(points), 3))
        barycentric[:, j] = np.clip(s, 0.0, 1.0)
        barycentric[:, i] = 1.0 - barycentric[:, j]
        candidates.append(barycentric)
    options = np.stack(candidates)  # [4, n, 3]
    distance = np.linalg.norm((options[..., None] * corners).sum(-2) - points, axis=-1)
    inside = (options >= 0).all(-1)
    best = np.where(inside, distance, np.inf).argmin(0)
    rows = np.arange(len(points))
    return options[best, rows], distance[best, rows]


def _foot(points: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Return barycentric coordinates of the perpendicular's foot; all -1 for a triangle without area."""
    normal = np.cross(b - a, c - a)
    area2 = (normal * normal).sum(1)
    flat = area2 <= 0
    safe = np.where(flat, 1.0, area2)
    v = (np.cross(points - a, c - a) * normal).sum(1) / safe
    w = (np.cross(b - a, points - a) * normal).sum(1) / safe
    return np.where(flat[:, None], -1.0, np.stack([1.0 - v - w, v, w], axis=1))


def displacement_figures(
    estimated: ModalMotion, true: ModalMotion, weights: np.ndarray, unit_scale_m: float | None = None
) -> dict[str, Any]:
    """Compare an estimated motion with the true one of the same Gaussians, weighted by `weights` [N].

    `relative_error`: rms over timesteps and Gaussians of (estimated − true), divided by the rms of the true.
    `rms_true`, `rms_estimated`, `rms_error`: those rms, scene units (and `…_mm` if `unit_scale_m` is known).
    `static_leak`: rms of the estimated motion of static Gaussians (true rms below 1 % of the largest), relative to the
    rms of the true motion of the others; None if either are invisible. `static_share`: their part of the weight.
    `per_frequency`: `frequency_figures`. Figures that divide by no motion are None. Raises ValueError if the three do
    not fit together.
    """
    weights = _check(estimated, true, weights)
    error2, true2, estimated2 = mean_squares(estimated, true)  # [N] each
    rms = {k: _rms(v, weights) for k, v in (("error", error2), ("true", true2), ("estimated", estimated2))}
    figures: dict[str, Any] = {
        "relative_error": _ratio(rms["error"], rms["true"]),
        **{f"rms_{k}": v for k, v in rms.items()},
        "static_leak": _leak(true2, estimated2, weights),
        "static_share": float(weights[_still(true2)].sum() / weights.sum()),
        "per_frequency": frequency_figures(estimated, true, weights, unit_scale_m),
    }
    return figures | _in_mm(rms, "rms_", unit_scale_m)


def frequency_figures(
    estimated: ModalMotion, true: ModalMotion, weights: np.ndarray, unit_scale_m: float | None = None
) -> list[dict[str, Any]]:
    """Compare both motions at each true frequency over the capture's timesteps.

    Both are projected on that frequency (their discrete-time Fourier sum over t = 0 … T−1), so that an estimate without
    a bin at the frequency is compared fairly. Per frequency, over Gaussians:
    `amplitude_true`, `amplitude_estimated`: weighted rms of the phasor's length (peak displacement of a
    motion along a line), scene units and mm; `amplitude_ratio`: their ratio; `relative_error`: rms of the
    phasors' difference over the rms of the true ones; `phase_error_deg`: of the weighted correlation,
    positive if the estimate is ahead; `direction_error_deg`: angle between the phasor vectors, arccos
    |⟨true, estimated⟩| / (|true| |estimated|), as between lines (0 to 90°, blind to phase), mean with weights
    × |true|² over the Gaussians that the estimate moves; `static_leak`: as in `displacement_figures`, by phasors and
    static Gaussians of that frequency; `mac`: modal assurance criterion, |Σ w a*·b|² / (Σ w |a|² Σ w |b|²), 1 for
    shapes that only differ by a complex factor.
    """
    weights = _check(estimated, true, weights)
    rows = []
    for frequency in np.unique(true.freqs_hz):
        a, b = (_phasor_at(m, float(frequency)) for m in (true, estimated))  # [N, 3] each
        amplitude = {k: _rms((np.abs(v) ** 2).sum(1), weights) for k, v in (("true", a), ("estimated", b))}
        correlation = complex((weights * (a.conj() * b).sum(1)).sum())
        rows.append(
            {
                "frequency_hz": float(frequency),
                **{f"amplitude_{k}": v for k, v in amplitude.items()},
                "amplitude_ratio": _ratio(amplitude["estimated"], amplitude["true"]),
                "relative_error": _ratio(_rms((np.abs(a - b) ** 2).sum(1), weights), amplitude["true"]),
                "phase_error_deg": float(np.degrees(np.angle(correlation))) if correlation else None,
                "direction_error_deg": _mean_angle(a, b, weights),
                "static_leak": _leak((np.abs(a) ** 2).sum(1), (np.abs(b) ** 2).sum(1), weights),
                "mac": _mac(a, b, weights),
                **_in_mm(amplitude, "amplitude_", unit_scale_m),
            }
        )
    return rows


def _check(estimated: ModalMotion, true: ModalMotion, weights: np.ndarray) -> np.ndarray:
    weights = np.asarray(weights, dtype=np.float64)
    n = {
        "estimated": estimated.n_gaussians,
        "true": true.n_gaussians,
        "weights": len(weights),
    }
    if len(set(n.values())) != 1 or weights.ndim != 1:
        raise ValueError(f"numbers of Gaussians differ: {n}")
    times = {(m.fps, m.n_timesteps) for m in (estimated, true)}
    if len(times) != 1:
        raise ValueError(f"estimated and true motion have different (fps, timesteps): {sorted(times)}")
    if not ((weights >= 0).all() and weights.sum() > 0):
        raise ValueError(f"weights must be ≥ 0 and not all 0; their sum is {weights.sum():g}")
    return weights


def mean_squares(estimated: ModalMotion, true: ModalMotion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return each Gaussian's mean over timesteps of |estimated − true|², |true|² and |estimated|², [N] each."""
    sums = np.zeros((3, true.n_gaussians))
    for t in range(true.n_timesteps):
        # Not rounded to float32 as for rendering, so that errors far below the motion are measured.
        b, a = (_displacement(m, t) for m in (estimated, true))
        sums += [((b - a) ** 2).sum(1), (a**2).sum(1), (b**2).sum(1)]
    error, truth, estimate = sums / true.n_timesteps
    return error, truth, estimate


def _displacement(motion: ModalMotion, t: int) -> np.ndarray:
    return np.tensordot((motion.gains_at(t) @ motion.series).real, motion.fields[..., :3], axes=1)


def _phasor_at(motion: ModalMotion, frequency: float) -> np.ndarray:
    """Return (2/T) Σ_t d(t) exp(−i 2π f t / fps), [N, 3]; with 1/T at 0 Hz and half the frame rate."""
    t = np.arange(motion.n_timesteps)
    gains = np.stack([motion.gains_at(int(i)) for i in t], 1)  # [K, T]
    against = np.exp(-2j * np.pi * frequency / motion.fps * t)
    forward = (gains * against).mean(1)
    backward = (gains.conj() * against).mean(1)
    factors = forward @ motion.series + backward @ motion.series.conj()
    both = np.tensordot(factors, motion.fields[..., :3], axes=1)
    alone = np.isclose(2 * frequency % motion.fps, 0)
    return both / 2 if alone else both


def _mean_angle(a: np.ndarray, b: np.ndarray, weights: np.ndarray) -> float | None:
    a2, b2 = (np.abs(a) ** 2).sum(1), (np.abs(b) ** 2).sum(1)
    seen = (weights * a2 > 0) & (b2 > 0)
    if not seen.any():
        return None
    a, b, a2, weights = a[seen], b[seen], a2[seen], (weights * a2)[seen]
    inner = (a.conj() * b).sum(1)
    across = b - a * (inner / a2)[:, None]
    # atan2, not acos: an angle near 0 keeps its digits.
    angle = np.arctan2(np.linalg.norm(across, axis=1), np.abs(inner) / np.sqrt(a2))
    return float(np.degrees((angle * weights).sum() / weights.sum()))


def _still(true2: np.ndarray) -> np.ndarray:
    return true2 <= STATIC_BELOW**2 * true2.max(initial=0.0)


def _leak(true2: np.ndarray, estimated2: np.ndarray, weights: np.ndarray) -> float | None:
    still = _still(true2)
    return _ratio(_rms(estimated2, weights * still), _rms(true2, weights * ~still))


def _mac(a: np.ndarray, b: np.ndarray, weights: np.ndarray) -> float | None:
    across = abs((weights * (a.conj() * b).sum(1)).sum()) ** 2
    both = (weights * (np.abs(a) ** 2).sum(1)).sum() * (weights * (np.abs(b) ** 2).sum(1)).sum()
    return float(across / both) if both > 0 else None


def _rms(squares: np.ndarray, weights: np.ndarray) -> float | None:
    total = weights.sum()
    return float(np.sqrt((squares * weights).sum() / total)) if total > 0 else None


def _ratio(numerator: float | None, denominator: float | None) -> float | None:
    return numerator / denominator if numerator is not None and denominator else None


def _in_mm(values: dict[str, float | None], prefix: str, unit_scale_m: float | None) -> dict[str, float]:
    if unit_scale_m is None:
        return {}
    return {f"{prefix}{k}_mm": v * unit_scale_m * 1000.0 for k, v in values.items() if v is not None}
