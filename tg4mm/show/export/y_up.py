"""A scene with Y up in place of Z up, as glTF and SPZ have it: turned by −90° about x."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...core.splatfile.model import SplatFile

TURN = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # (x, y, z) becomes (x, z, −y)
_HALF = np.sqrt(0.5)  # cosine and sine of 45°, half the turn
_DIRECTIONS = 64  # at which spherical harmonics are compared; 16 would do


def y_up(splat: SplatFile) -> SplatFile:
    """The same scene, its motion and its colours in axes of which Y points up."""
    turn = TURN.astype(np.float32)
    w, x, y, z = splat.quats.astype(np.float64).T
    quats = _HALF * np.stack([w + x, x - w, y + z, z - y], axis=1)  # (√½, −√½, 0, 0) times each
    return replace(
        splat,
        means=splat.means @ turn.T,
        quats=quats.astype(np.float32),
        sh=np.einsum("jk,nkc->njc", harmonics_turn(TURN, splat.sh.shape[1]), splat.sh).astype(np.float32),
        displacement=splat.displacement @ turn.T,
        rotation=splat.rotation @ turn.T,
    )


def harmonics_turn(turn: np.ndarray, count: int) -> np.ndarray:
    """[K, K] float64: what coefficients [K] become when the axes turn by the rotation matrix `turn` [3, 3].

    A colour seen along d is then seen along turn · d: Σ_j (X sh)_j Y_j(turn · d) = Σ_k sh_k Y_k(d). Solved from
    values in many directions, exact to rounding since turning mixes only the harmonics of one degree.
    """
    directions = np.random.default_rng(0).normal(size=(_DIRECTIONS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    before, after = harmonics(directions)[:, :count], harmonics(directions @ turn.T)[:, :count]
    return np.linalg.lstsq(after, before, rcond=None)[0]


def harmonics(directions: np.ndarray) -> np.ndarray:
    """[D, 16] float64: the real spherical harmonics of 3DGS (docs/conventions.md) at unit vectors [D, 3]."""
    x, y, z = np.asarray(directions, np.float64).T
    xx, yy, zz = x * x, y * y, z * z
    return np.stack(
        [
            np.full_like(x, 0.28209479177387814),
            -0.4886025119029199 * y,
            0.4886025119029199 * z,
            -0.4886025119029199 * x,
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (2 * zz - xx - yy),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (xx - yy),
            -0.5900435899266435 * y * (3 * xx - yy),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (4 * zz - xx - yy),
            0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
            -0.4570457994644658 * x * (4 * zz - xx - yy),
            1.445305721320277 * z * (xx - yy),
            -0.5900435899266435 * x * (xx - 3 * yy),
        ],
        axis=1,
    )
