"""Iteratively reweighted least squares on the prior's edges, so that it bends less over borders between parts.

The prior's squares make a jump dear: at the border of parts that move differently the field bends over several
Gaussians on either side. Once the motion is roughly known, an edge is reweighted as by Cauchy's robust loss,
w / (1 + s / 3s̄), with its squared residual s and the mean s̄ of all edges by their weights w (Holland & Welsch 1977).
Only a residual that two folds of the cameras share counts, so that noise changes no weight.
The folds then share the new weights: their difference underestimates the noise a little.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tg4mm.motion.prior.graph import Graph
from tg4mm.motion.prior.tgv import ROWS

_SCALE = 3.0  # mean squared residuals at which an edge counts half
_LEAST = 0.01  # of its weight is left to an edge: the graph stays connected


def edge_residual(graph: Graph, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """[E] float32, scene units squared: the squared residual of every edge that fields a, b [R, 4N, 3] share.

    Their residuals' inner product over fields and x, y, z, for a weight of 1; 0 where it is negative.
    """
    owner = np.repeat(np.arange(graph.n_gaussians), np.diff(graph.start))
    both = np.zeros(len(graph.other))
    for x, y in zip(a, b, strict=True):
        both += np.einsum("ec,ec->e", _residual(graph, owner, x), _residual(graph, owner, y))
    return np.asarray(np.maximum(both, 0), np.float32)


def _residual(graph: Graph, owner: np.ndarray, field: np.ndarray) -> np.ndarray:
    """[E, 3], for a weight of 1."""
    rows = field.reshape(-1, ROWS, 3)
    out = rows[graph.other, 0] - rows[owner, 0]
    for k in range(1, ROWS):
        half_way = graph.edge_rows[:, k] / graph.edge_rows[:, 0]
        out -= half_way[:, None] * (rows[graph.other, k] + rows[owner, k])
    return np.asarray(out)


def reweight_edges(graph: Graph, residual: np.ndarray) -> Graph:
    """The graph with edges reweighted by `edge_residual` [E]; the same graph where that is 0 everywhere."""
    weight = graph.edge_rows[:, 0].astype(np.float64) ** 2
    mean = float((weight * residual).sum() / weight.sum())
    if not mean > 0:
        return graph
    share = np.maximum(1 / (1 + residual / (_SCALE * mean)), _LEAST)
    return replace(graph, edge_rows=(graph.edge_rows * np.sqrt(share)[:, None]).astype(np.float32))
