"""Modes as few fields and their series: what a page holds of a motion, however many modes it has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tg4mm.fit.motion.modes import ModalMotion, fields_of

TOLERANCE = 1e-4  # of the motion's rms: weaker fields are left out


@dataclass(frozen=True)
class MotionFields:
    """m_k = Σ_r series[k, r] fields[r], real fields: the phasors of K modes by R ≤ 2K fields.

    At a time and magnification the motion is Σ_r c_r fields[r], c_r = Σ_k Re[series[k, r] g_k] with the modes' gains
    g_k. Each field's displacement and rotation have a largest size of 1 once divided by `sizes[r]`.
    """

    fields: (
        np.ndarray
    )  # [R, N, 6] float32: displacement in scene units, rotation vector in radians; over `sizes`
    sizes: np.ndarray  # [R, 2] float64: scene units, radians; 0 where a field does not move or not turn
    series: np.ndarray  # [K, R] complex128


def motion_fields(motion: ModalMotion, tolerance: float = TOLERANCE) -> MotionFields:
    """The motion's strongest fields; what is left out has an rms of at most `tolerance` of the motion's, each field.

    A motion that a fit found to have few components comes back with as many fields, whatever the number of its modes;
    parts that do not move are no field (`fields_of`).
    """
    fields, series = fields_of(motion, tolerance)
    sizes = np.abs(fields.reshape(len(fields), fields.shape[1], 2, 3)).max(axis=(1, 3), initial=0)
    unit = np.where(sizes > 0, sizes, 1).repeat(3, axis=1)
    return MotionFields(fields / unit[:, None], sizes.astype(np.float64), series)
