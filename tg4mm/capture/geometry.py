"""Optical axes of cameras, and the point nearest to all of them."""

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
