"""Optical axes of cameras, the point nearest to all of them, and the space they look at together."""

from __future__ import annotations

import numpy as np


def optical_axes(viewmats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Camera centres and unit viewing directions, both [C, 3] float64 in the world, of viewmats [C, 4, 4]."""
    viewmats = viewmats.astype(np.float64)
    centres = -np.einsum("cji,cj->ci", viewmats[:, :3, :3], viewmats[:, :3, 3])
    return centres, viewmats[:, 2, :3]


def nearest_point_equations(centres: np.ndarray, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A [3, 3] and b [3] of the normal equations A x = b of the point x nearest to all axes (least squares).

    A is singular where the axes are parallel; the caller decides what happens then.
    """
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]  # removes what lies along each axis
    return across.sum(0), np.einsum("cij,cj->i", across, centres)


def working_box(viewmats: np.ndarray, Ks: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, float]:
    """Centre [3] and half side (scene units) of the cube that cameras with pictures of size (W, H) look at together.

    The centre is the point nearest to all optical axes (least squares); the half side is what the widest camera
    sees at that distance.
    """
    origins, axes = optical_axes(viewmats)
    A, b = nearest_point_equations(origins, axes)
    # a small pull to a point in front of the mean camera settles parallel axes
    depth = np.median(np.linalg.norm(origins - origins.mean(0), axis=1))
    if depth < 1e-9 * (1 + np.abs(origins).max()):
        depth = 1.0  # cameras at one place see no distance: one scene unit, well beyond the near plane
    prior = origins.mean(0) + depth * axes.mean(0)
    centre = np.linalg.solve(A + 1e-3 * np.eye(3), b + 1e-3 * prior)
    distance = np.linalg.norm(origins - centre, axis=1)
    half_field = np.maximum(size[0] / Ks[:, 0, 0], size[1] / Ks[:, 1, 1]) / 2
    return centre, float(np.max(distance * half_field))
