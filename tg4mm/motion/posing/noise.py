"""What is noise: temporal components on which two halves of the cameras do not agree, and pixels that flicker.

Components of noise are dropped after a few iterations instead of being solved for. What they hold tells how noisy every
pixel is: shadows and gloss of a renderer, dark places of a sensor. Pixels count by the inverse of their variance, to
which the mean over all is added, so that none counts for more than twice the average one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tg4mm.motion.certainty.halves import agreed_gain
from tg4mm.motion.pictures.differences import TemporalComponents, pixel_noise
from tg4mm.motion.solver.pcg import on_cpu, start, step_all

_ITERATIONS = 2  # two to six tell the same
LOOSE = 30.0  # weight of the neighbours meanwhile: where much holds them together noise agrees too
_AGREED = 0.5  # gain below which a component is noise: more than half of its field


def noise_components(
    problem: Any, parts: Sequence[np.ndarray], images: np.ndarray, at_once: int
) -> np.ndarray:
    """[R] bool: which of the component images [V, R, H, W, 3] two halves (`parts`) of the cameras do not agree on.

    `problem`: MotionProblem or DeviceProblem of all cameras. The strongest component never counts as noise.
    """
    gains = []
    for first in range(0, images.shape[1], at_once):
        some = images[:, first : first + at_once]
        a, b = (_displacements(problem.of_views(rows), some[rows]) for rows in parts)
        gains.append(agreed_gain((a + b) / 2, a, b))
    is_noise = np.concatenate(gains) < _AGREED
    is_noise[0] = False
    return np.asarray(is_noise)


def _displacements(problem: Any, images: np.ndarray) -> np.ndarray:
    """[R, N, 3] after a few iterations."""
    states = [start(b) for b in problem.right_hand_sides(images)]
    for _ in range(_ITERATIONS):
        states = step_all(states, problem.normals)
    return np.stack([on_cpu(problem.field(state.x))[:, :3] for state in states])


def pixel_weights(components: TemporalComponents, is_noise: np.ndarray) -> np.ndarray | None:
    """[V, H, W] float32, at most 1, from the variance of what is noise; None where nothing is known of it."""
    variance = pixel_noise(components, is_noise)
    noisy = variance[variance > 0]
    if not len(noisy):
        return None
    return np.asarray(1 / (1 + variance / noisy.mean(dtype=np.float64)), np.float32)
