"""Feature matches of two pictures whose cameras are known: only what lies on the epipolar line may match.

COLMAP's own matcher compares every feature with every other and finds the geometry afterwards; on small pictures
and repeated texture its ratio test then drops most. With the cameras known, the few features near the epipolar line
are the only rivals, no random sampling is needed, and the result depends on nothing but the pictures.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ROWS = 1024  # features compared at once: bounds memory to ROWS × features


@dataclass(frozen=True)
class Features:
    """Features of one picture."""

    rays: np.ndarray  # [F, 3] float64, K⁻¹ (u, v, 1), camera axes
    descriptors: np.ndarray  # [F, D] float32 of unit length


def features_of(keypoints: np.ndarray, descriptors: np.ndarray, K: np.ndarray) -> Features:
    """Features at keypoints [F, ≥ 2] in pixels, with descriptors [F, D] of any length."""
    homogeneous = np.concatenate([keypoints[:, :2], np.ones((len(keypoints), 1))], axis=1)
    descriptors = descriptors.astype(np.float32)
    norm = np.maximum(np.linalg.norm(descriptors, axis=1, keepdims=True), 1e-9)
    return Features(homogeneous @ np.linalg.inv(K).T, descriptors / norm)


def essential(viewmat1: np.ndarray, viewmat2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """E [3, 3] with x₂ᵀ E x₁ = 0, and [R | t] [3, 4] of camera 2 from camera 1; viewmats are world-to-camera."""
    relative = (viewmat2 @ np.linalg.inv(viewmat1))[:3]
    x, y, z = relative[:, 3]
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ relative[:, :3], relative


def guided_matches(
    first: Features, second: Features, E: np.ndarray, tolerance: float, ratio: float, distance: float
) -> np.ndarray:
    """Matches [m, 2] (uint32, index in first and second): mutual nearest descriptors on the epipolar line.

    tolerance: Sampson distance on the plane z = 1, that is pixels / focal length. ratio: largest angle between
    descriptors, as a share of that to the second nearest on the line. distance: largest such angle, radians.
    """
    if len(first.rays) == 0 or len(second.rays) == 0:
        return np.zeros((0, 2), np.uint32)
    forward, angle = _nearest(first, second, E, tolerance, ratio, distance)
    backward, _ = _nearest(second, first, E.T, tolerance, ratio, distance)
    rows = np.flatnonzero(np.isfinite(angle))
    rows = rows[backward[forward[rows]] == rows]
    return np.stack([rows, forward[rows]], axis=1).astype(np.uint32)


def _nearest(
    first: Features, second: Features, E: np.ndarray, tolerance: float, ratio: float, distance: float
) -> tuple[np.ndarray, np.ndarray]:
    """For each feature of `first` its match in `second` (−1: none) and their angle (inf: none)."""
    nearest = np.full(len(first.rays), -1, np.int64)
    angles = np.full(len(first.rays), np.inf)
    lines1 = (second.rays @ E)[:, :2]  # of each second feature, in the first picture
    for start in range(0, len(first.rays), ROWS):
        part = slice(start, start + ROWS)
        lines2 = first.rays[part] @ E.T
        scale = (lines2[:, :2] ** 2).sum(1)[:, None] + (lines1**2).sum(1)[None]
        near = (lines2 @ second.rays.T) ** 2 < tolerance**2 * scale
        cosine = first.descriptors[part] @ second.descriptors.T
        cosine[~near] = -1
        best = cosine.argmax(axis=1)
        rows = np.arange(len(best))
        angle = np.arccos(np.clip(cosine[rows, best], -1, 1))
        cosine[rows, best] = -1
        rival = np.arccos(np.clip(cosine.max(axis=1), -1, 1))
        good = near[rows, best] & (angle < distance) & (angle < ratio * rival)
        nearest[part] = np.where(good, best, -1)
        angles[part] = np.where(good, angle, np.inf)
    return nearest, angles
