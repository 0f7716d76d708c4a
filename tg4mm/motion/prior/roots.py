"""Random fields as the prior has them, by its edges: a sparse root of the stiffness matrix.

The stiffness is a sum of squares over edges. With one row for each square, S, it is SᵀS, and Sᵀz of a normal z has it
as its covariance: what perturbs a solution as if the prior had been drawn anew.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, vstack

from tg4mm.motion.prior.graph import BENDING, ROWS, Graph


def stiffness_root(graph: Graph, means: np.ndarray) -> csr_matrix:
    """S [4E, 4N] float64 with SᵀS = `graph.stiffness`, from the graph of Gaussians at means [N, 3].

    An edge's weight stands in the stiffness itself, between its ends' displacements, plus what their gradients add:
    −w_ij there, since u_j − u_i − ½ (A_i + A_j) d is squared.
    """
    n = len(means)
    between = graph.stiffness[::ROWS, ::ROWS].tocoo()
    upper = between.row < between.col
    first, second = between.row[upper].astype(np.int64), between.col[upper].astype(np.int64)
    root = np.sqrt(np.maximum(-between.data[upper].astype(np.float64), 0))
    arms = (means[second] - means[first]).astype(np.float64) / graph.reach
    edges = np.arange(len(first))
    values = [root, *(-0.5 * arms * root[:, None]).T, -root, *(-0.5 * arms * root[:, None]).T]
    columns = [ROWS * end + c for end in (second, first) for c in range(ROWS)]
    shape = (len(edges), ROWS * n)
    rows = np.tile(edges, 2 * ROWS)
    parts = [coo_matrix((np.concatenate(values), (rows, np.concatenate(columns))), shape=shape)]
    bent = np.sqrt(BENDING) * root
    for c in range(1, ROWS):
        ends = (np.tile(edges, 2), np.concatenate([ROWS * second + c, ROWS * first + c]))
        parts.append(coo_matrix((np.concatenate([bent, -bent]), ends), shape=shape))
    return csr_matrix(vstack(parts))
