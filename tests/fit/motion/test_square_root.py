"""The root of the prior's matrix: its square is the matrix, and what is drawn with it has that covariance."""

from __future__ import annotations

import numpy as np
import pytest

from tg4mm.fit.motion.prior.graph import Graph, build_graph, stiffness_root


@pytest.fixture(scope="module")
def cloud() -> Graph:
    rng = np.random.default_rng(0)
    means = rng.random((60, 3)).astype(np.float32)
    axes = np.tile(np.eye(3, dtype=np.float32), (60, 1, 1))
    return build_graph(means, axes, rng.uniform(0.01, 0.1, (60, 3)).astype(np.float32))


def test_its_square_is_the_prior(cloud: Graph) -> None:
    its = cloud
    root = stiffness_root(its)
    expected = its.stiffness.toarray().astype(np.float64)
    np.testing.assert_allclose((root.T @ root).toarray(), expected, atol=1e-5 * np.abs(expected).max())


def test_draws_have_its_covariance(cloud: Graph) -> None:
    its = cloud
    root = stiffness_root(its)
    draws = root.T @ np.random.default_rng(1).standard_normal((root.shape[0], 4000))
    diagonal = its.stiffness.diagonal()
    np.testing.assert_allclose((draws**2).mean(1), diagonal, rtol=0.15)
