"""How much less a camera sees of motion along its line of sight than of motion across it."""

from __future__ import annotations

import numpy as np

from tg4mm.motion.jacobian.packed import DOF
from tg4mm.motion.jacobian.view import ViewJacobian
from tg4mm.motion.pictures.video import FixedCamera


def lines_of_sight(camera: FixedCamera, means: np.ndarray) -> np.ndarray:
    """Unit vectors [N, 3] from the camera to the points `means` [N, 3]."""
    turn, shift = camera.viewmat[:3, :3].astype(np.float64), camera.viewmat[:3, 3]
    return _of_length_one(means + turn.T @ shift)  # from the camera's centre −Rᵀt


def directions(camera: FixedCamera, means: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The lines of sight to the points `means` [N, 3], and unit vectors across them, along the pictures' rows."""
    along = lines_of_sight(camera, means)
    return along, _of_length_one(np.cross(along, camera.viewmat[1, :3].astype(np.float64)))


def _of_length_one(v: np.ndarray) -> np.ndarray:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-12))


def sight_ratio(view: ViewJacobian, camera: FixedCamera, means: np.ndarray, seed: int = 0) -> float:
    """Change of the picture (rms) for motion towards the camera over that for motion across, same lengths.

    means [N, 3] in scene units. Signs are random from Gaussian to Gaussian, so that nothing cancels but by chance.
    0 where no motion across is seen.
    """
    along, across = directions(camera, means)
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (len(means), 1))
    seen = []
    for direction in (along, across):
        motion = np.zeros((len(means), DOF), np.float32)
        motion[:, :3] = signs * direction
        seen.append(float(np.sqrt((view.jvp(motion[None]).astype(np.float64) ** 2).sum())))
    return seen[0] / seen[1] if seen[1] > 0 else 0.0
