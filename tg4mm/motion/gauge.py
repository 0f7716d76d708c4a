"""Motions that the pictures leave open, and which of them is taken.

A shaking or moving camera leaves six motions of the scene undetermined.

To fields that explain the pictures any rigid motion of the whole scene may be added, since the camera's unknown pose
takes it up. Of all these the one is taken in which most of the scene stands still: the rigid motion that is nearest to
the field in the sum of distances (not of their squares), by iteratively reweighted least squares, is taken off.
"""

from __future__ import annotations

import numpy as np

_ROUNDS = 30
_SMALL = 0.05  # of the median distance: nearer than that counts no more


def with_still_background(fields: np.ndarray, means: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Fields [R, N, 6] of one frequency less the rigid motions [R, 6] that most of the scene has.

    means [N, 3] scene units; weights [N]: how much of a Gaussian is seen.
    """
    centre = np.average(means, axis=0, weights=weights + 1e-12)
    x = means.astype(np.float64) - centre
    design = np.zeros((len(means), 3, 6))
    design[:, range(3), range(3)] = 1
    design[:, 0, 4], design[:, 0, 5] = x[:, 2], -x[:, 1]  # ω × x
    design[:, 1, 3], design[:, 1, 5] = -x[:, 2], x[:, 0]
    design[:, 2, 3], design[:, 2, 4] = x[:, 1], -x[:, 0]
    u = fields[..., :3].astype(np.float64)
    trust = weights.astype(np.float64)
    rigid = np.zeros((len(fields), 6))
    for _ in range(_ROUNDS):
        weighted = design * trust[:, None, None]
        gram = np.einsum("nci,ncj->ij", weighted, design)
        sides = np.einsum("nci,rnc->ri", weighted, u)
        rigid = np.linalg.lstsq(gram, sides.T, rcond=1e-9)[0].T
        left = np.sqrt(((u - np.einsum("nci,ri->rnc", design, rigid)) ** 2).sum((0, 2)))
        trust = weights / np.maximum(left, _SMALL * float(np.median(left)) + 1e-12)
    out = fields.copy()
    out[..., :3] -= np.einsum("nci,ri->rnc", design, rigid).astype(np.float32)
    out[..., 3:] -= rigid[:, None, 3:].astype(np.float32)
    return out


def in_plane(fields: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Fields [..., N, 6] in the plane across `normal` [3]: displacement within it, rotation about it.

    For a flat capture, whose one camera shows nothing of the rest.
    """
    out = fields.copy()
    out[..., :3] -= (fields[..., :3] @ normal)[..., None] * normal
    out[..., 3:] = (fields[..., 3:] @ normal)[..., None] * normal
    return out
