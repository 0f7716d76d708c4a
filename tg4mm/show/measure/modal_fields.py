"""A run's modal motion as a few fields and their functions of time: the rest of the scene while a region is measured.

A synchronous capture's motion has as many independent fields as temporal components, mostly one to five, in
whatever number of frequencies it is stored.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.modes import ModalMotion

_WEAKEST = 1e-9  # of the strongest field's energy


@dataclass(frozen=True)
class ModalFields:
    """Motion at a time: Σ_r (mixing @ [Re g; Im g])_r fields[r], with the modes' gains g."""

    fields: np.ndarray  # [R, N, 6] float32, displacement (scene units) and rotation vector (radians)
    mixing: np.ndarray  # [R, 2K] float64
    freqs_hz: np.ndarray  # [K]

    @staticmethod
    def of(motion: ModalMotion | None, n_gaussians: int) -> "ModalFields":
        """Make the fields of a run's motion; no field where it has none."""
        if motion is None or not len(motion.freqs_hz):
            return ModalFields(np.zeros((0, n_gaussians, DOF), np.float32), np.zeros((0, 0)), np.zeros(0))
        both = np.concatenate([motion.displacement, motion.rotation], 2).reshape(len(motion.freqs_hz), -1)
        rows = np.concatenate([both.real, -both.imag]).astype(np.float32)
        shifts = np.concatenate([motion.displacement.real, -motion.displacement.imag]).reshape(len(rows), -1)
        values, vectors = np.linalg.eigh((shifts @ shifts.T).astype(np.float64))
        kept = vectors[:, values > _WEAKEST * max(values[-1], 1e-300)].T
        fields = (kept.astype(np.float32) @ rows).reshape(len(kept), n_gaussians, DOF)
        return ModalFields(fields, kept, np.asarray(motion.freqs_hz, np.float64))

    def series(self, times_s: np.ndarray, phases: np.ndarray | None = None) -> np.ndarray:
        """[R, F]: the functions of time on a clock whose motion is ahead by phases [K], radians."""
        angles = 2 * np.pi * self.freqs_hz[:, None] * times_s
        if phases is not None:
            angles = angles + phases[:, None]
        return np.asarray(self.mixing @ np.concatenate([np.cos(angles), np.sin(angles)]))


def clock_phases(figures: Mapping[str, Any], name: str, freqs_hz: np.ndarray) -> np.ndarray | None:
    """[K] radians of camera `name` from a fit's figures, where every camera has a clock of its own; None elsewhere."""
    known = figures.get("clip_phases_deg", {}).get(name)
    if known is None:
        return None
    hz, degrees = np.array([float(k) for k in known]), np.array(list(known.values()))
    nearest = np.abs(freqs_hz[:, None] - hz).argmin(1)
    return np.radians(degrees[nearest])
