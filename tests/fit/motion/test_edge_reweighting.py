"""Joints: edges that both halves of the cameras find strained are loosened between the fit's two turns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.capture import load_capture, load_images
from tg4mm.capture.truth_file import load_truth
from tg4mm.fit.motion import MotionConfig
from tg4mm.fit.motion.prior import graph as edge_reweighting
from tg4mm.fit.motion.prior.graph import Graph, build_graph, edge_residual, reweight_edges
from tg4mm.research.evaluate.displacement import displacement_figures
from tg4mm.research.evaluate.truth import exact_motion
from tg4mm.run import Run
from tg4mm.run.stages.motion import train_motion
from tg4mm.show.weights import blending_weights

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


def test_what_is_linear_in_space_strains_nothing() -> None:
    means, g = cloud()
    gradient = np.random.default_rng(1).normal(size=(3, 3))
    x = field(g, means @ gradient + [1, 2, 3], gradient)
    assert edge_residual(g, x, x).max() < 1e-9
    assert edge_residual(g, 0.5 * x, 0.5 * x).max() < 1e-9


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


def test_what_the_halves_do_not_agree_on_strains_little() -> None:
    """Noise of the same size in both, drawn for each: a tenth of what it would be if they agreed."""
    _, g = cloud()
    rng = np.random.default_rng(2)
    a, b = (field(g, rng.normal(size=(COUNT, 3)), np.zeros((3, 3))) for _ in range(2))
    a, b = (np.concatenate([v] + [np.roll(v, k, 1) for k in range(4, 120, 4)]) for v in (a, b))
    assert edge_residual(g, a, b).mean() < 0.1 * edge_residual(g, a, a).mean()


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


@pytest.fixture(scope="module")
def six(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six cameras; the post sways beside a ball that moves otherwise, on a floor that stands still."""
    root = tmp_path_factory.mktemp("edges")
    gaussians, _ = make_synthetic_dataset(
        root / "data", n_views=6, n_timesteps=5, size=32, freqs=(6.0,), alphas=(), n_test=0, amplitude=0.005
    )
    run = Run.create(root / "run", root / "data", "modal", {})
    run.save_space(gaussians, {})
    return root


def trained(six: Path, path: Path, weight: float) -> tuple[Run, np.ndarray]:
    gaussians = Run.open(six / "run").load_space()
    run = Run.open(path) if path.exists() else Run.create(path, six / "data", "modal", {})
    if not run.has_space:
        run.save_space(gaussians, {})
    capture = load_capture(six / "data")
    config = MotionConfig(components=1, iterations=10, tolerance=1e-6, smoothness_weight=weight)
    return run, train_motion(run, capture, load_images(capture), config).displacement


def test_what_stands_still_is_given_less_of_its_neighbours_motion(
    six: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, _ = trained(six, tmp_path / "reweighted", 3_000.0)
    monkeypatch.setattr(edge_reweighting, "_SCALE", 1e9)  # nothing is ever strained
    other, _ = trained(six, tmp_path / "none", 3_000.0)
    capture = load_capture(six / "data")
    weights = blending_weights(run.load_space(), capture)
    truth = load_truth(six / "data", capture.fps, capture.n_timesteps)
    exact = exact_motion(truth, run.load_space().means.numpy())
    reweighted, without = (
        displacement_figures(m.selected(m.freqs_hz > 0), exact, weights)
        for m in map(Run.load_motion, (run, other))
    )
    assert reweighted["static_leak"] < 0.9 * without["static_leak"]
    assert reweighted["relative_error"] < without["relative_error"]
