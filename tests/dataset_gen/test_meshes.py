"""Mesh builders against areas and normals known in closed form."""

import numpy as np
import pytest

from dataset_gen import meshes as m


def signed_volume(mesh):
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return (a * np.cross(b, c)).sum() / 6.0


def test_a_revolved_cylinder_has_its_area_and_faces_outwards():
    mesh = m.revolve([(0.0, 0.0), (0.5, 0.0), (0.5, 2.0), (0.0, 2.0)], segments=400)
    area = m.triangle_areas(mesh.vertices, mesh.triangles).sum()
    assert area == pytest.approx(2 * np.pi * 0.5 * 2.0 + 2 * np.pi * 0.25, rel=1e-3)
    assert signed_volume(mesh) == pytest.approx(np.pi * 0.25 * 2.0, rel=1e-3)


def test_a_swept_tube_is_closed_and_faces_outwards():
    path = np.column_stack([np.zeros(9), np.zeros(9), np.linspace(0.0, 3.0, 9)])
    mesh = m.sweep(path, m.circle(0.2, 200), up=(1.0, 0.0, 0.0))
    assert signed_volume(mesh) == pytest.approx(np.pi * 0.04 * 3.0, rel=1e-3)


def test_a_closed_sweep_is_a_torus():
    angle = np.linspace(0.0, 2 * np.pi, 200, endpoint=False)
    path = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(200)])
    mesh = m.sweep(path, m.circle(0.1, 100), closed=True)
    assert abs(signed_volume(mesh)) == pytest.approx(2 * np.pi**2 * 0.01, rel=2e-3)


def test_edges_are_doubled_where_sharp_and_shared_where_smooth():
    sharp = m.revolve([(1.0, 0.0), (1.0, 1.0), (0.5, 1.0)], segments=8)
    smooth = m.revolve([(1.0, 0.0), (1.0, 1.0), (0.95, 1.9)], segments=8)
    assert len(sharp.vertices) == 4 * 8
    assert len(smooth.vertices) == 3 * 8


def test_a_spline_passes_its_ends_in_equal_steps():
    curve = m.spline([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 1)])
    np.testing.assert_allclose(curve[[0, -1]], [(0, 0, 0), (0, 1, 1)], atol=1e-12)
    steps = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    assert steps.max() / steps.min() < 1.1
