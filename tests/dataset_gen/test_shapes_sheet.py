"""Sheets, puffed bodies, scattered copies and carvings: closed, outwards, where they should be."""

import numpy as np
import pytest

from dataset_gen import meshes as m
from dataset_gen.patterns import solid as unroll
from dataset_gen.shapes.cushion import Outline, frames_on, moulding
from dataset_gen.shapes.scatter import on_surface
from dataset_gen.shapes.sheet import puff, puff_points, rounded, sheet
from tests.dataset_gen.builtin import open_edges, volume


def test_a_sheet_round_an_axis_is_a_sphere():
    height, turn = (
        np.linspace(-np.pi / 2, np.pi / 2, 60)[:, None],
        np.linspace(0, 2 * np.pi, 80, endpoint=False),
    )
    flat = np.cos(height)
    flat[[0, -1]] = 0.0
    points = np.stack(np.broadcast_arrays(flat * np.cos(turn), flat * np.sin(turn), np.sin(height)), -1)
    ball = sheet(points, around=True)
    assert open_edges(ball) == 0
    assert volume(ball) == pytest.approx(4 / 3 * np.pi, rel=5e-3)
    assert len(ball.vertices) == 58 * 80 + 2  # the poles are welded


def _ellipsoid(count=81):
    x, share = Outline(2.0, 1.0, 2.0).disc(count)
    middle = np.dstack([x, 0.0 * share])
    return middle, 0.5 * rounded(share, 2.0), 0.3 * rounded(share, 2.0)


def test_a_puffed_disc_is_an_ellipsoid():
    body = puff(*_ellipsoid())
    assert open_edges(body) == 0
    assert volume(body) == pytest.approx(2 / 3 * np.pi * 2.0 * (0.5 + 0.3), rel=0.01)


def test_texels_of_a_puffed_body_lie_where_its_texture_coordinates_put_them():
    shape = _ellipsoid()
    body, grid = puff(*shape), puff_points(*shape)
    rows, columns = grid.shape[:2]
    r, s = np.rint(body.uv[..., 1] * (rows - 1)), np.rint(body.uv[..., 0] * (columns - 1))
    found = grid[r.astype(int), s.astype(int)]
    np.testing.assert_allclose(found, body.vertices[body.triangles], atol=1e-7)


def test_scattered_points_lie_on_the_mesh_apart_from_each_other():
    ball = m.revolve([(np.cos(a), np.sin(a)) for a in np.linspace(-np.pi / 2, np.pi / 2, 40)], 80)
    points, up = on_surface(ball, 50, np.random.default_rng(0), apart=0.2)
    assert len(points) == 50
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0, atol=3e-3)
    assert ((points * up).sum(1) > 0.99).all()
    gaps = np.linalg.norm(points[:, None] - points[None], axis=2) + 9 * np.eye(50)
    assert gaps.min() > 0.2
    upper = ball.vertices[ball.triangles].mean(1)[:, 2] > 0
    above, _ = on_surface(ball, 50, np.random.default_rng(0), allowed=upper.astype(float))
    assert above[:, 2].min() > -0.05


def test_a_moulding_round_a_circle_is_a_torus_whichever_way_it_runs():
    rim = Outline(1.0, 1.0, 2.0).rim(300)
    for path in (rim, rim[::-1]):
        place = frames_on(lambda p: np.concatenate([p, np.zeros((len(p), 1))], 1), path)
        torus = moulding(*place, m.circle(0.1, 40))
        assert open_edges(torus) == 0
        assert volume(torus) == pytest.approx(2 * np.pi**2 * 0.01, rel=0.01)


def test_unrolled_surfaces_lie_on_their_meshes():
    outline = [(0.2, 0.0), (0.5, 0.4), (0.3, 1.0)]
    points = unroll.of_revolved(outline, 200, 90)
    radius = np.hypot(points[..., 0], points[..., 1])
    np.testing.assert_allclose(radius, np.interp(points[..., 2], [0.0, 0.4, 1.0], [0.2, 0.5, 0.3]), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(unroll.of_ball(20, 40), axis=-1), 1.0, rtol=1e-5)
    tube = unroll.of_tube(0.1, 2.0, 50, 30)
    np.testing.assert_allclose(np.hypot(tube[..., 0], tube[..., 1]), 0.1, rtol=1e-5)
    assert 1.9 < np.ptp(tube[..., 2]) < 2.0
