"""From fields to motions and back: a Gaussian's displacement, and the rotation that its gradient makes.

`following.py` says how a Gaussian turns.
"""

from __future__ import annotations

import numpy as np

from tg4mm.rasterize.kernels.compiled import kernel


@kernel()
def _turn(turns, field, motion):
    for i in range(len(turns)):
        for d in range(3):
            motion[i, d] = field[i, d]
            total = turns[i, 0, d] * field[i, 3]
            for k in range(1, 9):
                total += turns[i, k, d] * field[i, 3 + k]
            motion[i, 3 + d] = total


@kernel()
def _turn_back(turns, v_motion, v_field):
    for i in range(len(turns)):
        x, y, z = v_motion[i, 3], v_motion[i, 4], v_motion[i, 5]
        for d in range(3):
            v_field[i, d] = v_motion[i, d]
        for k in range(9):
            v_field[i, 3 + k] = turns[i, k, 0] * x + turns[i, k, 1] * y + turns[i, k, 2] * z


def turned(turns: np.ndarray, field: np.ndarray) -> np.ndarray:
    """Displacement and rotation [N, 6] of a field [N, 12] (displacement and gradient); turns [N, 9, 3]; float32."""
    motion = np.empty((len(turns), 6), np.float32)
    _turn(turns, field, motion)
    return motion


def turned_back(turns: np.ndarray, v_motion: np.ndarray) -> np.ndarray:
    """The transpose of `turned`: [N, 6] -> [N, 12]."""
    v_field = np.empty((len(turns), 12), np.float32)
    _turn_back(turns, v_motion, v_field)
    return v_field
