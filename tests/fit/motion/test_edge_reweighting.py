"""Joints: edges that both halves of the cameras find strained are loosened between the fit's two turns."""

from __future__ import annotations

import numpy as np
import pytest

from tg4mm.fit.motion.prior.graph import Graph, build_graph, edge_residual, reweight_edges

COUNT = 400


def cloud() -> tuple[np.ndarray, Graph]:
    rng = np.random.default_rng(0)
    means = rng.random((COUNT, 3))
    return means, build_graph(means, np.tile(np.eye(3), (COUNT, 1, 1)), np.full((COUNT, 3), 0.02))


def field(g: Graph, u: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """[1, 4N, 3] of displacements u [N, 3] and one gradient [3, 3] (d u_c / d x_k at [k, c]) everywhere."""
    rows = np.concatenate([u[:, None], np.tile(gradient * g.mean_spacing, (len(u), 1, 1))], 1)
    return rows.reshape(1, -1, 3).astype(np.float32)


def ends(g: Graph) -> tuple[np.ndarray, np.ndarray]:
    return np.repeat(np.arange(g.n_gaussians), np.diff(g.start)), g.other


def test_a_jump_strains_the_edges_across_it_by_its_square() -> None:
    means, g = cloud()
    left = means[:, 0] < 0.5
    x = field(g, np.where(left[:, None], [0.3, 0, -0.4], 0.0), np.zeros((3, 3)))
    owner, other = ends(g)
    np.testing.assert_allclose(
        edge_residual(g, x, x), np.where(left[owner] != left[other], 0.25, 0), atol=1e-6
    )
    twice = np.concatenate([x, x])
    np.testing.assert_allclose(edge_residual(g, twice, twice), 2 * edge_residual(g, x, x), rtol=1e-6)
    assert not edge_residual(g, x, -x).any()  # the halves contradict each other
    assert not edge_residual(g, x, 0 * x).any()


def test_strained_edges_count_less_and_the_matrix_stays_what_it_is() -> None:
    _, g = cloud()
    owner, other = ends(g)
    of_edge = (((owner + other) * 7919) % 13 / 13.0) ** 4  # the same from both ends
    looser = reweight_edges(g, of_edge.astype(np.float32))
    before, after = (graph.edge_rows[:, 0].astype(np.float64) ** 2 for graph in (g, looser))
    mean = (before * of_edge).sum() / before.sum()
    np.testing.assert_allclose(after / before, 1 / (1 + of_edge / (3 * mean)), rtol=1e-5)
    matrix = looser.stiffness.toarray()
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-5 * np.abs(matrix).max())
    assert np.linalg.eigvalsh(matrix.astype(np.float64)).min() > -1e-5 * np.abs(matrix).max()
    assert reweight_edges(g, np.zeros(len(other), np.float32)) is g
    alone = np.zeros(len(other), np.float32)
    alone[0] = 1.0
    weakest = reweight_edges(g, alone).edge_rows[0, 0] / g.edge_rows[0, 0]
    assert weakest == pytest.approx(0.1, rel=1e-5)  # a hundredth of its weight
