"""What the cameras that show motion see of the Gaussians, and how long a displacement is in their pictures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tg4mm.capture import Capture
from tg4mm.core.phasors import peak_displacement, scale_top
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.observations import frames_of
from tg4mm.show.weights import blending_weights

_CAMERAS = 4  # looked at, spread evenly over those that show motion
_TOP = 0.99  # of what is seen: outliers of a fit must not decide


@dataclass(frozen=True)
class Seen:
    """Blending weights, and for each camera the rows [N, 2, 3] that turn a displacement (scene units) into pixels."""

    weights: np.ndarray  # [N]
    rows: tuple[np.ndarray, ...]  # 0 where a camera does not see the Gaussian; () without a dataset
    inside: tuple[np.ndarray, ...]  # [N] bool of each camera

    def pixels(self, phasors: np.ndarray) -> float | None:
        """Amplitude in pixels of phasors [N, 3] complex: 99th percentile of what is seen; None without a camera."""
        if not self.rows:
            return None
        amplitudes = [peak_displacement(np.einsum("nab,nb->na", row, phasors)) for row in self.rows]
        return scale_top(np.concatenate(amplitudes), np.concatenate(self._weights()), _TOP)

    def rms_pixels(self, covariance: np.ndarray) -> float | None:
        """Standard deviation across the pictures, rms over what is seen, of a displacement's covariance [N, 3, 3]."""
        if not self.rows:
            return None
        variances = [np.einsum("nab,nbc,nac->n", row, covariance, row) for row in self.rows]
        weights = np.concatenate(self._weights())
        return float(np.sqrt((weights * np.concatenate(variances)).sum() / max(weights.sum(), 1e-30)))

    def _weights(self) -> list[np.ndarray]:
        return [self.weights * inside for inside in self.inside]


def seen_by(gaussians: Gaussians, capture: Capture | None) -> Seen:
    """By up to four of the cameras that show motion; without a capture all Gaussians count by their opacity."""
    if capture is None:
        return Seen(gaussians.opacities.numpy().astype(np.float64), (), ())
    _, frames = frames_of(capture)
    some = [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, _CAMERAS).round().astype(int))]
    chosen = np.array([f.rows[0] for f in some])
    weights = blending_weights(gaussians, capture.selected(chosen))
    means = gaussians.means.numpy().astype(np.float64)
    projected = [pixel_rows(means, f.viewmat, f.K, (capture.width, capture.height)) for f in some]
    return Seen(weights, tuple(p[0] for p in projected), tuple(p[1] for p in projected))


def pixel_rows(
    means: np.ndarray, viewmat: np.ndarray, K: np.ndarray, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Derivative [N, 2, 3] of the pixel by the position of points [N, 3], and whether they lie in the picture [N]."""
    x, y, z = (means @ viewmat[:3, :3].T + viewmat[:3, 3]).T
    front = z > 1e-6
    z = np.where(front, z, 1.0)
    u, v = K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]
    inside = front & (u >= 0) & (u < size[0]) & (v >= 0) & (v < size[1])
    zero = np.zeros_like(z)
    by_camera = np.stack(
        [
            np.stack([K[0, 0] / z, zero, -K[0, 0] * x / z**2], -1),
            np.stack([zero, K[1, 1] / z, -K[1, 1] * y / z**2], -1),
        ],
        1,
    )
    return np.where(inside[:, None, None], by_camera @ viewmat[:3, :3].astype(np.float64), 0.0), inside
