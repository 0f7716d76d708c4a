"""Surface samples and exact nearest points on triangles."""

import numpy as np
import pytest

from tg4mm.research.evaluate.truth import closest_on_triangles, sample_surface

SQUARE = np.array([[0.0, 0, 0], [3, 0, 0], [3, 1, 0], [0, 1, 0]])
TWO_TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])


def brute_force_distance(point: np.ndarray, corners: np.ndarray, n: int = 400) -> float:
    """Least distance from a point to a dense grid on the triangle: an upper bound, close to exact."""
    u, v = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n))
    keep = u + v <= 1 + 1e-12
    grid = np.stack([1 - u[keep] - v[keep], u[keep], v[keep]], 1) @ corners
    return float(np.linalg.norm(grid - point, axis=1).min())


def test_samples_are_on_the_triangles_and_hold_every_vertex() -> None:
    s = sample_surface(SQUARE, TWO_TRIANGLES, 1000)
    np.testing.assert_allclose(s.barycentric.sum(1), 1)
    assert (s.barycentric >= -1e-12).all()
    np.testing.assert_allclose((SQUARE[s.triangles] * s.barycentric[..., None]).sum(1), s.points)
    assert s.tree.query(SQUARE)[0].max() == 0.0
    assert 1000 <= len(s.points) <= 1010


def test_samples_are_dense_everywhere_and_follow_area() -> None:
    s = sample_surface(SQUARE, TWO_TRIANGLES, 1000)
    rng = np.random.default_rng(0)
    anywhere = np.column_stack([rng.uniform(0, 3, 5000), rng.uniform(0, 1, 5000), np.zeros(5000)])
    assert s.tree.query(anywhere)[0].max() < 2.0 * np.sqrt(3 / 1000)
    # A triangle of nine times the area gets nine times the samples.
    vertices = np.concatenate([SQUARE[:3], 10 + 3 * SQUARE[:3]])
    counts = np.bincount(
        sample_surface(vertices, np.array([[0, 1, 2], [3, 4, 5]]), 1000).triangles[:, 0], minlength=4
    )
    assert counts[3] / counts[0] == pytest.approx(9, rel=0.05)


def test_samples_are_deterministic() -> None:
    a, b = (sample_surface(SQUARE, TWO_TRIANGLES, 500).points for _ in range(2))
    np.testing.assert_array_equal(a, b)


def test_loose_vertices_and_flat_triangles_are_samples_too() -> None:
    vertices = np.concatenate([SQUARE, [[9.0, 9, 9]]])
    s = sample_surface(vertices, np.array([[0, 1, 2], [1, 1, 1]]), 100)
    assert s.tree.query([[9.0, 9, 9], [0, 1, 0]])[0].max() == 0.0
    only_points = sample_surface(vertices, np.zeros((0, 3), int), 100)
    assert np.isfinite(only_points.points).all()
    assert only_points.tree.query(vertices)[0].max() == 0.0


def test_interpolation_is_exact_for_a_linear_field() -> None:
    s = sample_surface(SQUARE, TWO_TRIANGLES, 50)
    values = SQUARE @ np.arange(9.0).reshape(3, 3) * (1 + 2j)
    which = np.array([[0, 5], [17, 30]])
    np.testing.assert_allclose(
        s.interpolate(values[None], which)[0], s.points[which] @ np.arange(9.0).reshape(3, 3) * (1 + 2j)
    )


def test_the_closest_point_is_the_brute_force_one() -> None:
    rng = np.random.default_rng(0)
    corners, points = rng.standard_normal((60, 3, 3)), 2 * rng.standard_normal((60, 3))
    barycentric, distance = closest_on_triangles(points, corners)
    assert (barycentric >= 0).all()
    np.testing.assert_allclose(barycentric.sum(1), 1)
    np.testing.assert_allclose(
        np.linalg.norm((barycentric[..., None] * corners).sum(1) - points, axis=1), distance
    )
    expected = np.array([brute_force_distance(p, c) for p, c in zip(points, corners, strict=True)])
    assert (distance <= expected + 1e-12).all()
    np.testing.assert_allclose(distance, expected, atol=2e-3)
    # Feet inside, on edges and on corners all occur, so that each branch is compared.
    assert set(np.unique((barycentric > 1e-9).sum(1))) == {1, 2, 3}


def test_a_triangle_without_area_is_its_longest_edge() -> None:
    corners = np.array([[[0.0, 0, 0], [1, 0, 0], [2, 0, 0]], [[1.0, 1, 1]] * 3])
    _, distance = closest_on_triangles(np.array([[1.5, 2, 0], [1, 1, 4]]), corners)
    np.testing.assert_allclose(distance, [2, 3])
