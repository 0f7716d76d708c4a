"""The point nearest to optical axes, where it is known."""

import numpy as np

from tg4mm.capture.cameras import nearest_point_equations, optical_axes


def test_axes_of_a_moved_and_turned_camera():
    viewmat = np.eye(4, dtype=np.float32)
    viewmat[:3, :3] = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]  # looks along the world's x
    viewmat[:3, 3] = -viewmat[:3, :3] @ [1, 2, 3]
    centres, axes = optical_axes(viewmat[None])
    np.testing.assert_allclose(centres, [[1, 2, 3]])
    np.testing.assert_allclose(axes, [[1, 0, 0]])
    assert centres.dtype == axes.dtype == np.float64


def test_two_skew_axes_are_nearest_half_way_between():
    centres, axes = np.array([[-5.0, 0, 1], [2, -3, 3]]), np.array([[1.0, 0, 0], [0, 1, 0]])
    A, b = nearest_point_equations(centres, axes)
    np.testing.assert_allclose(np.linalg.solve(A, b), [2, 0, 2], atol=1e-12)


def test_parallel_axes_leave_the_equations_singular():
    A, _ = nearest_point_equations(np.eye(3), np.tile([0.0, 0, 1], (3, 1)))
    assert np.linalg.matrix_rank(A) == 2
