"""How far a complex displacement goes in the course of a cycle, in scene units and in pixels."""

from __future__ import annotations

import numpy as np


def reach(shape: np.ndarray) -> np.ndarray:
    """Largest |Re(s e^{iθ})| over all θ of vectors s [..., D]: half the major axis of their ellipses [...].

    With s = a + ib it is the larger singular value of the matrix [a, b], in closed form.
    """
    a, b = np.real(shape), np.imag(shape)
    aa, bb, ab = (a * a).sum(-1), (b * b).sum(-1), (a * b).sum(-1)
    return np.asarray(np.sqrt(0.5 * (aa + bb) + np.hypot(0.5 * (aa - bb), ab)))


def pixel_displacement(
    positions: np.ndarray,
    shape: np.ndarray,
    camera_to_world: np.ndarray,
    fl_x: float,
    fl_y: float,
    width: int | None = None,
    height: int | None = None,
) -> float:
    """Largest displacement in pixels, over points and over the cycle, of a complex shape seen by a camera.

    To first order: the shape [V, 3] goes through the Jacobian of the pinhole projection at `positions` [V, 3].
    `camera_to_world` [4, 4] has OpenGL axes; focal lengths are in pixels. Points behind the camera do not count,
    and given `width` and `height` (principal point in the middle) neither do points outside the picture. Hidden
    points count: nothing is known of what lies in front. 0 if no point counts.
    """
    rotation = np.asarray(camera_to_world, np.float64)[:3, :3]
    local = (positions - np.asarray(camera_to_world)[:3, 3]) @ rotation
    depth = -local[:, 2]
    seen = depth > 1e-9
    local, depth, moved = local[seen], depth[seen], shape[seen] @ rotation
    x, y = local[:, 0] / depth, local[:, 1] / depth
    if width is not None and height is not None:
        inside = (np.abs(fl_x * x) <= 0.5 * width) & (np.abs(fl_y * y) <= 0.5 * height)
        x, y, depth, moved = x[inside], y[inside], depth[inside], moved[inside]
    # Depth grows against local z: d(X/depth) = (dX + x dZ) / depth.
    columns = fl_x * (moved[:, 0] + x * moved[:, 2]), fl_y * (moved[:, 1] + y * moved[:, 2])
    return float(reach(np.stack(columns, -1) / depth[:, None]).max(initial=0.0))
