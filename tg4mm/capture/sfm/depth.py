"""The 3D position of a picture's point, from other pictures of it or from known points around it.

One picture gives the ray. On a plane, inverse depth is affine in the position on the plane z = 1, so the points
around the pixel are fitted by one, robustly, and the ray's depth is read off it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from tg4mm.core.errors import Tg4mmError

CLICK_PX = 1.0  # standard deviation of a place that a person points at
AROUND = 24  # nearest points that the plane is laid through, at most
FEWEST = 6
NEAR = 0.08  # of the picture's longer side: how far off they may be
SHALLOWEST_DEG = 1.0  # between two sights of a point
MISFIT_PX = 10.0  # by which sights of one point may miss it
TUKEY = 4.685  # standard deviations, for an efficiency of 95 %


@dataclass(frozen=True)
class Sight:
    """A pixel of a placed picture."""

    name: str  # as the user calls the picture
    image: Any  # pycolmap Image
    camera: Any  # pycolmap Camera
    pixel: np.ndarray  # [2]

    @property
    def pose(self) -> np.ndarray:
        """[3, 4] camera from world."""
        return np.asarray(self.image.cam_from_world().matrix())

    @property
    def ray(self) -> np.ndarray:
        """[3] towards what the pixel shows, camera axes, z = 1."""
        return np.append(np.asarray(self.camera.cam_from_img(self.pixel)).ravel()[:2], 1.0)

    @property
    def angle(self) -> float:
        """What CLICK_PX is on the plane z = 1."""
        return CLICK_PX / float(self.camera.mean_focal_length())


@dataclass(frozen=True)
class Spot:
    """A point in space and how well it is known."""

    xyz: np.ndarray  # [3]
    covariance: np.ndarray  # [3, 3]


def triangulated(sights: Sequence[Sight], steps: int = 10) -> Spot:
    """The point that two or more pictures show: Gauss–Newton on the distances on the planes z = 1.

    Raises Tg4mmError where the rays are nearly parallel, miss each other, or meet behind a picture.
    """
    centres = np.stack([-s.pose[:, :3].T @ s.pose[:, 3] for s in sights])
    rays = np.stack([s.pose[:, :3].T @ s.ray for s in sights])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    widest = np.degrees(np.arccos(np.clip((rays @ rays.T).min(), -1, 1)))
    names = ", ".join(s.name for s in sights)
    if widest < SHALLOWEST_DEG:
        raise Tg4mmError(
            f"--length: {names} see the point from directions {widest:.2f}° apart, too close for depth; "
            "mark it in another picture"
        )
    across = np.eye(3) - rays[:, :, None] * rays[:, None]
    xyz = np.linalg.solve(across.sum(0), np.einsum("sij,sj->i", across, centres))
    for _ in range(steps):
        residual, jacobian = _equations(sights, xyz)
        xyz = xyz - np.linalg.lstsq(jacobian, residual, rcond=None)[0]
    residual, jacobian = _equations(sights, xyz)
    miss = float(np.linalg.norm(residual.reshape(-1, 2), axis=1).max()) * CLICK_PX
    if not miss <= MISFIT_PX:
        raise Tg4mmError(
            f"--length: {names} do not show the same point there: they miss it by {miss:.0f} pixels"
        )
    if behind := [s.name for s in sights if s.pose[2, :3] @ xyz + s.pose[2, 3] <= 0]:
        raise Tg4mmError(
            f"--length: {names} meet behind {behind[0]}: are the pixels those of these pictures, in this order?"
        )
    return Spot(
        xyz, np.linalg.inv(jacobian.T @ jacobian) * max(1.0, float(residual @ residual) / len(residual))
    )


def _equations(sights: Sequence[Sight], xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals [2 S] in standard deviations of a click, and their derivatives [2 S, 3] by the point."""
    residuals, rows = [], []
    for sight in sights:
        cam = sight.pose[:, :3] @ xyz + sight.pose[:, 3]
        residuals.append((cam[:2] / cam[2] - sight.ray[:2]) / sight.angle)
        projection = np.array([[1, 0, -cam[0] / cam[2]], [0, 1, -cam[1] / cam[2]]]) / cam[2]
        rows.append(projection @ sight.pose[:, :3] / sight.angle)
    return np.concatenate(residuals), np.concatenate(rows)


def depth_among_points(sight: Sight, model: Any) -> Spot:
    """The point of one picture's pixel, on the plane through the points found around it.

    Raises Tg4mmError where there are too few, or the plane does not face the camera.
    """
    pose = sight.pose
    seen = [p for p in sight.image.points2D if p.has_point3D()]
    pixels = np.array([p.xy for p in seen]).reshape(-1, 2)
    reach = NEAR * max(sight.camera.width, sight.camera.height)
    distance = np.linalg.norm(pixels - sight.pixel, axis=1)
    order = [int(i) for i in np.argsort(distance)[:AROUND] if distance[i] <= reach]
    if len(order) < FEWEST:
        raise Tg4mmError(
            f"--length: {len(order)} points are known within {reach:.0f} pixels of {sight.pixel[0]:g}, "
            f"{sight.pixel[1]:g} in {sight.name}, at least {FEWEST} are needed; mark it in a second picture"
        )
    xyz = np.array([model.points3D[seen[i].point3D_id].xyz for i in order])
    cam = xyz @ pose[:, :3].T + pose[:, 3]
    inverse, spread = _plane(cam[:, :2] / cam[:, 2:] - sight.ray[:2], 1 / cam[:, 2])
    if inverse <= 2 * spread:
        raise Tg4mmError(
            f"--length: the points around {sight.pixel[0]:g}, {sight.pixel[1]:g} in {sight.name} lie on no surface; "
            "mark it in a second picture"
        )
    depth = 1 / inverse
    covariance = np.diag([(sight.angle * depth) ** 2] * 2 + [0.0])
    covariance += np.outer(sight.ray, sight.ray) * (spread * depth**2) ** 2
    turned = pose[:, :3].T @ covariance @ pose[:, :3]
    return Spot(pose[:, :3].T @ (depth * sight.ray - pose[:, 3]), turned)


def _plane(offsets: np.ndarray, inverse: np.ndarray, rounds: int = 10) -> tuple[float, float]:
    """Inverse depth at offset 0 and its standard deviation, of an affine fit to `inverse` [M] at `offsets` [M, 2].

    From the triple of points whose plane has the least median residual (Rousseeuw 1984), Tukey's weights.
    """
    A = np.concatenate([np.ones((len(offsets), 1)), offsets], axis=1)
    triples = np.array(list(combinations(range(len(A)), 3)))
    planes = np.linalg.pinv(A[triples], rcond=1e-4) @ inverse[triples][..., None]
    medians = np.median(np.abs(A @ planes - inverse[:, None])[..., 0], axis=1)
    solution = planes[int(medians.argmin()), :, 0]
    for _ in range(rounds):
        residual = np.abs(inverse - A @ solution)
        sigma = 1.4826 * float(np.median(residual)) * np.sqrt(len(A) / max(len(A) - 3, 1))
        weights = np.maximum(0.0, 1 - (residual / (TUKEY * max(sigma, 1e-12))) ** 2) ** 2
        normal = np.linalg.pinv(A.T @ (weights[:, None] * A))
        solution = normal @ (A.T @ (weights * inverse))
    return float(solution[0]), sigma * float(np.sqrt(max(normal[0, 0], 0.0)))
