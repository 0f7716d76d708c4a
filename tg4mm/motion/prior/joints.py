"""Joints: where two halves of the cameras agree that neighbours move apart, the prior holds them less.

The prior's squares make a jump dear, so that at the border of parts that move differently the field bends over several
Gaussians on either side. Once the motion is roughly known, an edge whose misfit both halves see counts as in Cauchy's
robust loss, w / (1 + s / 3s̄) with its strain s and the mean strain s̄ of all edges by their weights w (Holland & Welsch
1977). Halves then share what was loosened: their difference says a little less of the noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tg4mm.motion.prior.graph import Graph
from tg4mm.motion.prior.stiffness import ROWS

_TIMES = 3.0  # the mean strain, from which on an edge counts less than half: docs/decisions.md
_LEAST = 0.01  # of its weight is left to an edge, so that nothing comes loose altogether


def strain(graph: Graph, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """[E] float32, scene units squared: the squared misfit of every edge that fields a, b [R, 4N, 3] agree on.

    Sums over fields and over x, y, z, for a weight of 1; 0 where they contradict each other.
    """
    owner = np.repeat(np.arange(graph.n_gaussians), np.diff(graph.start))
    both = np.zeros(len(graph.other))
    for x, y in zip(a, b, strict=True):
        both += np.einsum("ec,ec->e", _misfit(graph, owner, x), _misfit(graph, owner, y))
    return np.asarray(np.maximum(both, 0), np.float32)


def _misfit(graph: Graph, owner: np.ndarray, field: np.ndarray) -> np.ndarray:
    """[E, 3], for a weight of 1."""
    rows = field.reshape(-1, ROWS, 3)
    out = rows[graph.other, 0] - rows[owner, 0]
    for k in range(1, ROWS):
        half_way = graph.bonds[:, k] / graph.bonds[:, 0]
        out -= half_way[:, None] * (rows[graph.other, k] + rows[owner, k])
    return np.asarray(out)


def loosened(graph: Graph, strain: np.ndarray) -> Graph:
    """The graph with edges that count less the more strained [E] they are; the same where nothing is strained."""
    weight = graph.bonds[:, 0].astype(np.float64) ** 2
    mean = float((weight * strain).sum() / weight.sum())
    if not mean > 0:
        return graph
    share = np.maximum(1 / (1 + strain / (_TIMES * mean)), _LEAST)
    return replace(graph, bonds=(graph.bonds * np.sqrt(share)[:, None]).astype(np.float32))
