"""The motion triplane: three feature planes per resolution, sampled bilinearly at every Gaussian, summed.

[TG4MM] Eqs. (4) and (5) with a linear decoder, several resolutions at once. Its value at a Gaussian is a
displacement; being linear, it is one sparse matrix. A last level holds one value per Gaussian, for what no plane
can tell apart.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, hstack, identity

_COARSEST = 8
_PLANES = ((0, 1), (0, 2), (1, 2))
_FREE_SHARE = 0.3  # prior standard deviation of the free level beside a plane's


def _plane(points: np.ndarray, resolution: int) -> csr_matrix:
    """[N, resolution²]: bilinear weights of points [N, 2] in 0..1 on a grid with nodes on its border."""
    position = np.clip(points, 0, 1) * (resolution - 1)
    cell = np.minimum(position.astype(int), resolution - 2)
    fraction = position - cell
    rows, columns, values = [], [], []
    for dx in (0, 1):
        for dy in (0, 1):
            wx = fraction[:, 0] if dx else 1 - fraction[:, 0]
            wy = fraction[:, 1] if dy else 1 - fraction[:, 1]
            rows.append(np.arange(len(points)))
            columns.append((cell[:, 0] + dx) * resolution + cell[:, 1] + dy)
            values.append(wx * wy)
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return coo_matrix(entries, shape=(len(points), resolution**2)).tocsr()


def resolutions(finest: int) -> list[int]:
    """8, 16, 32 … up to `finest`; none if it is smaller than 8."""
    out = []
    r = _COARSEST
    while r <= finest:
        out.append(r)
        r *= 2
    return out


def sampling_matrix(means: np.ndarray, finest: int) -> csr_matrix:
    """[N, P] float32: from all parameters (of one coordinate) to the value at each Gaussian.

    means [N, 3] in scene units; the planes span the box of the middle 98 % of them. Columns are scaled so that a
    ridge of the same weight on every parameter is the prior.
    """
    low, high = np.percentile(means, [1, 99], axis=0)
    unit = (means - low) / np.maximum(high - low, 1e-12).max()
    levels = [_plane(unit[:, axes], resolution) for resolution in resolutions(finest) for axes in _PLANES]
    levels.append(identity(len(means), format="csr") * _FREE_SHARE)
    return hstack(levels).tocsr().astype(np.float32)
