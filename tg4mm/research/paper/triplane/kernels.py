"""numba kernels of bilinear sampling at fixed points, and its transpose. Both are gathers: no two threads write one
place, and every sum has a fixed order, so results are bit-identical on any number of threads."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(parallel=True, cache=True, fastmath={"contract"})
def gather(values: np.ndarray, index: np.ndarray, weight: np.ndarray, out: np.ndarray) -> None:
    """out [N, 3 C] = Σ_j weight · values[index]: values [A, C], index and weight [3, N, 4]."""
    channels = values.shape[1]
    for n in numba.prange(index.shape[1]):
        for k in range(3):
            a, b, c, d = index[k, n, 0], index[k, n, 1], index[k, n, 2], index[k, n, 3]
            wa, wb, wc, wd = weight[k, n, 0], weight[k, n, 1], weight[k, n, 2], weight[k, n, 3]
            for i in range(channels):
                out[n, k * channels + i] = (
                    wa * values[a, i] + wb * values[b, i] + wc * values[c, i] + wd * values[d, i]
                )


@numba.njit(parallel=True, cache=True, fastmath={"contract"})
def gather_back(
    v_out: np.ndarray,
    first: np.ndarray,
    point: np.ndarray,
    plane: np.ndarray,
    share: np.ndarray,
    v_values: np.ndarray,
) -> None:
    """The transpose: v_values [A, C] from v_out [N, 3 C]; entries of every cell as in `Cells`."""
    channels = v_values.shape[1]
    for a in numba.prange(len(first) - 1):
        for i in range(channels):
            v_values[a, i] = 0.0
        for e in range(first[a], first[a + 1]):
            n, at, w = point[e], plane[e] * channels, share[e]
            for i in range(channels):
                v_values[a, i] += w * v_out[n, at + i]
