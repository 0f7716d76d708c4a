"""The prior on motion: what costs nothing, what does, and the rotation that a gradient of displacement is.

How Gaussians turn with what they are made of: whole if rigid, balls by the curl, flakes and needles as they lie.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tg4mm.fit.motion.prior import (
    BENDING,
    ROWS,
    build_graph,
    edge_residual,
    gradient_to_rotation,
    reweight_edges,
    stiffness_root,
)

OMEGA, SHIFT = np.array([0.02, -0.03, 0.05]), np.array([0.1, 0.2, -0.3])
AXES = {"ball": (1, 1, 1), "flake": (1, 1, 0.02), "needle": (0.02, 1, 0.02), "any": (1, 0.6, 0.3)}


def volume(n=300):
    return np.random.default_rng(0).uniform(-1, 1, (n, 3))


def plane(n=300):
    """Tilted, without thickness."""
    uv = np.random.default_rng(1).uniform(-1, 1, (n, 2))
    return uv @ np.array([[1, 0, 0.5], [0, 1, -0.3]])


def wire(n=60):
    """Straight, along (1, 2, 2) / 3."""
    return np.linspace(-1, 1, n)[:, None] * np.array([1, 2, 2]) / 3


def graph(means, count=12):
    """The graph of balls."""
    return build_graph(means, np.tile(np.eye(3), (len(means), 1, 1)), np.ones((len(means), 3)), count)


SHAPES = {"volume": volume, "plane": plane, "wire": wire}


def field(around, u, gradient):
    """[4N, 3] of displacements [N, 3] and gradients [3 (along), 3 (of)] or [N, 3, 3], per scene unit."""
    gradient = np.broadcast_to(gradient, (len(u), 3, 3)) * around.mean_spacing
    return np.concatenate([u[:, None], gradient], 1).reshape(-1, 3).astype(np.float32)


def energy(around, x):
    return float((x.astype(np.float64) * (around.stiffness.astype(np.float64) @ x)).sum())


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("kind", ["shift", "turn", "stretch", "shear"])
def test_what_is_linear_in_space_costs_nothing(shape, kind):
    """And at half its gradient it costs."""
    means = SHAPES[shape]()
    around = graph(means)
    along = {
        "shift": np.zeros((3, 3)),
        "turn": np.cross(OMEGA, np.eye(3)),  # rows: ω × e_along
        "stretch": np.diag([0.05, -0.01, 0.02]),
        "shear": np.array([[0, 0.04, 0], [0, 0, 0], [0.01, 0, 0]]),
    }[kind]
    u = SHIFT + means @ along
    size = float((field(around, u, along).astype(np.float64) ** 2).sum())
    rounding = float(np.finfo(np.float32).eps) * size  # of the matrix's entries, about 1 on the diagonal
    assert abs(energy(around, field(around, u, along))) < rounding
    if kind != "shift":
        assert energy(around, field(around, u, along / 2)) > 10 * rounding


@pytest.mark.parametrize("shape", SHAPES)
def test_its_energy_is_the_sum_over_pairs(shape):
    """Σ w (|u_j − u_i − ½ (A_i + A_j) d|² + b |A_j − A_i|²), pair by pair by hand, up to one factor."""
    means = SHAPES[shape](40)
    around, rng = graph(means, count=6), np.random.default_rng(3)
    fields = [rng.normal(size=(ROWS * 40, 3)) * scale for scale in (1, 2, 5)]
    fields.append(field(around, means[:, :1] * means, np.eye(3) / 9).astype(np.float64))
    ratios = [brute_energy(around, means, x, 6) / energy(around, x) for x in fields]
    np.testing.assert_allclose(ratios, ratios[0], rtol=1e-4)


def brute_energy(around, means, x, count):
    weights: dict[tuple[int, int], float] = {}
    for i in range(len(means)):
        distance = np.linalg.norm(means - means[i], axis=1)
        near = np.argsort(distance, kind="stable")[1 : count + 1]
        for j in near:
            w = float(np.exp(-0.5 * (distance[j] / distance[near].mean()) ** 2))
            pair = (min(i, int(j)), max(i, int(j)))
            weights[pair] = weights.get(pair, 0.0) + w
    f, total = x.reshape(-1, ROWS, 3), 0.0
    for (i, j), w in weights.items():
        d = (means[j] - means[i]) / around.mean_spacing
        left = f[j, 0] - f[i, 0] - d @ (f[i, 1:] + f[j, 1:]) / 2
        total += w * ((left**2).sum() + BENDING * ((f[j, 1:] - f[i, 1:]) ** 2).sum())
    return total


def test_a_turn_is_found_from_its_gradient():
    means = volume()
    around = graph(means)
    x = field(around, SHIFT + np.cross(OMEGA, means), np.cross(OMEGA, np.eye(3)))
    moved = around.motion(x)
    assert moved.dtype == np.float32
    np.testing.assert_allclose(moved[:, :3], SHIFT + np.cross(OMEGA, means), atol=1e-6)
    np.testing.assert_allclose(moved[:, 3:], np.tile(OMEGA, (300, 1)), atol=1e-6)


def test_from_motion_is_the_transpose():
    around, rng = graph(volume()), np.random.default_rng(4)
    x, v = rng.normal(size=(ROWS * 300, 3)).astype(np.float32), rng.normal(size=(300, 6)).astype(np.float32)
    one = (around.motion(x).astype(float) * v).sum()
    other = (around.from_motion(v).astype(float) * x).sum()
    assert abs(one - other) < 1e-6 * np.linalg.norm(around.motion(x)) * np.linalg.norm(v)


@pytest.mark.parametrize("n", [2, 4, 13])
def test_fewer_gaussians_than_neighbours_are_all_neighbours(n):
    around = graph(volume(n))
    pairs = around.stiffness[::ROWS, ::ROWS].tocoo()
    assert ((pairs.row != pairs.col) & (pairs.data != 0)).sum() == n * (n - 1)


@pytest.mark.parametrize("shape", SHAPES)
def test_products_without_the_matrix_are_those_with_it(shape):
    around, rng = graph(SHAPES[shape]()), np.random.default_rng(5)
    x = rng.normal(size=(ROWS * around.n_gaussians, 3)).astype(np.float32)
    out = rng.normal(size=x.shape).astype(np.float32)
    expected = out + 3.0 * (around.blocks @ x.astype(float)) + 0.5 * x
    around.add_prior(x, 3.0, 0.5, out)
    np.testing.assert_allclose(out, expected, atol=2e-6 * np.abs(expected).max())


def test_the_matrix_is_that_of_the_edges_both_ways():
    """Dense, edge by edge."""
    around = graph(volume(40))
    expected = np.zeros((160, 160))
    for i in range(40):
        for edge in range(around.start[i], around.start[i + 1]):
            row, j = np.zeros((ROWS, 160)), around.other[edge]
            own = around.edge_rows[edge].astype(float)
            row[0, ROWS * i : ROWS * i + ROWS] = -own
            row[0, ROWS * j : ROWS * j + ROWS] = own * [1, -1, -1, -1]
            for k in range(1, ROWS):
                row[k, [ROWS * i + k, ROWS * j + k]] = np.sqrt(BENDING) * own[0] * np.array([1, -1])
            expected += row.T @ row / 2  # listed at both ends
    np.testing.assert_allclose(around.blocks.toarray(), expected, atol=1e-5 * expected.max())


@pytest.mark.parametrize("shape", SHAPES)
def test_the_root_squared_is_the_matrix(shape):
    around = graph(SHAPES[shape](60))
    root, expected = stiffness_root(around), around.stiffness.toarray().astype(np.float64)
    np.testing.assert_allclose((root.T @ root).toarray(), expected, atol=1e-5 * np.abs(expected).max())


def ends(around):
    return np.repeat(np.arange(around.n_gaussians), np.diff(around.start)), around.other


def test_a_jump_strains_the_edges_across_it_by_its_square():
    means = volume(400)
    around = graph(means)
    left = means[:, 0] < 0
    x = field(around, np.where(left[:, None], [0.3, 0, -0.4], 0.0), np.zeros((3, 3)))[None]
    owner, other = ends(around)
    across = np.where(left[owner] != left[other], 0.25, 0)
    np.testing.assert_allclose(edge_residual(around, x, x), across, atol=1e-6)
    twice = np.concatenate([x, x])
    once = edge_residual(around, x, x)
    np.testing.assert_allclose(edge_residual(around, twice, twice), 2 * once, rtol=1e-6)
    assert not edge_residual(around, x, -x).any()  # the halves contradict each other
    assert not edge_residual(around, x, 0 * x).any()


def test_strained_edges_count_less_and_the_matrix_stays_what_it_is():
    g = graph(volume(400))
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


def rotation_of(gradient, axes, scales):
    """[3] for a gradient [along, of]."""
    return gradient.reshape(9) @ gradient_to_rotation(axes[None], np.array([scales], float))[0]


@pytest.mark.parametrize("shape", AXES)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_rigid_turn_is_followed_whole(shape, seed):
    axes = Rotation.random(random_state=seed).as_matrix()
    turn = rotation_of(np.cross(OMEGA, np.eye(3)), axes, AXES[shape])
    np.testing.assert_allclose(turn, OMEGA, atol=1e-7)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_needle_and_a_flake_stay_on_their_material(seed):
    """Any gradient: the needle's direction d moves by G d across itself, the flake's normal n by −Gᵀ n."""
    rng = np.random.default_rng(seed)
    axes = Rotation.random(random_state=seed).as_matrix()
    gradient = 0.01 * rng.normal(size=(3, 3))  # [along, of]: G = gradientᵀ
    d = axes[:, 1]
    across = gradient.T @ d - d * (d @ gradient.T @ d)
    bound, turn = 0.02 * np.abs(gradient).max(), rotation_of(gradient, axes, AXES["needle"])
    np.testing.assert_allclose(np.cross(turn, d), across, atol=bound)
    n = axes[:, 2]
    tilt = -(gradient @ n) + n * (n @ gradient @ n)
    turn = rotation_of(gradient, axes, AXES["flake"])
    np.testing.assert_allclose(np.cross(turn, n), tilt, atol=bound)


@pytest.mark.parametrize("shape", AXES)
def test_the_covariance_changes_as_nearly_as_a_turn_can(shape):
    """Against other rotations: none is nearer to GΣ + ΣGᵀ by more than the little that is drawn to half the curl."""
    scales = AXES[shape]
    rng, axes = np.random.default_rng(4), Rotation.random(random_state=4).as_matrix()
    gradient = rng.normal(size=(3, 3))
    covariance = axes @ np.diag(np.square(scales, dtype=float)) @ axes.T

    def left(omega):
        spin = np.cross(omega, np.eye(3)).T
        change = (gradient.T - spin) @ covariance
        return float(((change + change.T) ** 2).sum())

    found = rotation_of(gradient, axes, scales)
    nearest = min(left(found + 0.2 * rng.normal(size=3)) for _ in range(200))
    assert left(found) < nearest + 0.03 * left(np.zeros(3))
    curl = np.array([gradient[i, j] - gradient[j, i] for i, j in ((1, 2), (2, 0), (0, 1))])
    if shape == "ball":
        np.testing.assert_allclose(found, curl / 2, atol=1e-5)
    else:
        assert np.linalg.norm(found - curl / 2) > 0.1 * np.linalg.norm(curl)
