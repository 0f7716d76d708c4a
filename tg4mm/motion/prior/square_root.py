"""A sparse square root of the prior's matrix, to draw from the posterior by perturbation (Papandreou & Yuille 2010).

The matrix K is a sum of squares over edges. With one row for each square, K = SᵀS, and Sᵀz of a standard normal z has
covariance K: the perturbation of the right-hand side that a new draw from the prior is.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, vstack

from tg4mm.motion.prior.graph import BENDING, ROWS, Graph


def stiffness_root(graph: Graph) -> csr_matrix:
    """S [4E, 4N] float64 with SᵀS = `graph.stiffness` of E edges: displacements, then gradients along x, y, z."""
    n = graph.n_gaussians
    owner = np.repeat(np.arange(n), np.diff(graph.start))
    once = owner < graph.other  # every edge is listed at both ends
    first, second = owner[once], graph.other[once].astype(np.int64)
    rows = graph.edge_rows[once].astype(np.float64)
    root, half = rows[:, 0], rows[:, 1:]
    edges, shape = np.arange(len(first)), (len(first), ROWS * n)
    values = np.concatenate([root, *-half.T, -root, *-half.T])
    columns = np.concatenate([ROWS * end + c for end in (second, first) for c in range(ROWS)])
    parts = [coo_matrix((values, (np.tile(edges, 2 * ROWS), columns)), shape=shape)]
    bending = np.sqrt(BENDING) * np.concatenate([root, -root])
    for c in range(1, ROWS):
        ends = np.concatenate([ROWS * second + c, ROWS * first + c])
        parts.append(coo_matrix((bending, (np.tile(edges, 2), ends)), shape=shape))
    return csr_matrix(vstack(parts))
