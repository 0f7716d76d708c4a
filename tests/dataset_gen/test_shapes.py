"""Meshes, sheets, solids and patterns in space: areas and volumes in closed form, outwards, where they should be."""

from __future__ import annotations

import numpy as np
import pytest

from dataset_gen import meshes as m
from dataset_gen.patterns import minerals, solid
from dataset_gen.patterns import solid as unroll
from dataset_gen.shapes import bricks, drums, solids
from dataset_gen.shapes.scatter import on_surface
from dataset_gen.shapes.sheet import Outline, frames_on, moulding, puff, puff_points, rounded, sheet
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


PATH = np.column_stack([np.zeros(9), np.zeros(9), np.linspace(0.0, 3.0, 9)])
ROUND = m.circle(1.0, 400)
ARC = np.column_stack([np.cos(turn := np.linspace(0.5, 2.0, 200)), np.sin(turn)])
RIM = Outline(1.0, 1.0, 2.0).rim(300)


def _torus(path):
    place = frames_on(lambda p: np.concatenate([p, np.zeros((len(p), 1))], 1), path)
    return moulding(*place, m.circle(0.1, 40))


@pytest.mark.parametrize(
    ("body", "expected", "rel", "closed"),
    [
        (lambda: puff(*_ellipsoid()), 2 / 3 * np.pi * 2.0 * (0.5 + 0.3), 0.01, True),
        (lambda: _torus(RIM), 2 * np.pi**2 * 0.01, 0.01, True),
        (lambda: _torus(RIM[::-1]), 2 * np.pi**2 * 0.01, 0.01, True),
        (lambda: solids.pierced(ROUND, 0.5 * ROUND, 0.0, 2.0), 2.0 * np.pi * 0.75, 1e-3, False),
        (lambda: solids.lamella(2.0 * ARC, 3.0 * ARC, 0.0, 2.0), 0.5 * 1.5 * 5.0 * 2.0, 1e-3, False),
        (lambda: solids.lamella(3.0 * ARC, 2.0 * ARC, 0.0, 2.0), 0.5 * 1.5 * 5.0 * 2.0, 1e-3, False),
        (lambda: drums.tube(PATH, 0.2, 0.15, segments=300), 3.0 * np.pi * (0.2**2 - 0.15**2), 1e-3, False),
        (lambda: m.sweep(PATH, m.circle(0.2, 200), up=(1.0, 0.0, 0.0)), 0.12 * np.pi, 1e-3, False),
    ],
)  # fmt: skip
def test_a_body_faces_outwards_and_has_the_volume_of_its_formula(body, expected, rel, closed):
    mesh = body()
    assert volume(mesh) == pytest.approx(expected, rel=rel)
    assert not closed or open_edges(mesh) == 0


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


def test_unrolled_surfaces_lie_on_their_meshes():
    outline = [(0.2, 0.0), (0.5, 0.4), (0.3, 1.0)]
    points = unroll.of_revolved(outline, 200, 90)
    radius = np.hypot(points[..., 0], points[..., 1])
    np.testing.assert_allclose(radius, np.interp(points[..., 2], [0.0, 0.4, 1.0], [0.2, 0.5, 0.3]), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(unroll.of_ball(20, 40), axis=-1), 1.0, rtol=1e-5)
    tube = unroll.of_tube(0.1, 2.0, 50, 30)
    np.testing.assert_allclose(np.hypot(tube[..., 0], tube[..., 1]), 0.1, rtol=1e-5)
    assert 1.9 < np.ptp(tube[..., 2]) < 2.0


def test_a_block_has_its_volume_and_a_bevel_takes_the_edges_off():
    assert solids.volume(solids.block((0, 0, 0), (1, 2, 3))) == pytest.approx(6.0)
    bevelled = solids.volume(solids.block((0, 0, 0), (1, 2, 3), 0.1))
    # Twelve prisms of ½·0.1² along edges of total length 4·(1 + 2 + 3); corners overlap a little.
    assert 6.0 - 0.005 * 24 < bevelled < 6.0 - 0.005 * (24 - 12 * 0.2)


def test_a_brick_on_a_brick_hides_the_studs_below_it():
    model = bricks.BrickModel(np.random.default_rng(0))
    model.brick("red", (0, 0, 0), (4, 2, 1.2))
    model.brick("blue", (0, 0, 1.2), (2, 2, 1.2))
    parts = model.parts()
    one = len(bricks.stud().vertices)
    assert len(parts["red_studs"].vertices) == 4 * one
    assert len(parts["blue_studs"].vertices) == 4 * one
    assert parts["red_studs"].vertices[:, 0].min() > 2.0


def test_cube_mapping_keeps_the_scale():
    mesh = solids.cube_mapped(solids.block((0, 0, 0), (1, 2, 3)), 4.0)
    a, b, c = (mesh.uv[:, k] for k in range(3))
    ab, ac = b - a, c - a
    area = 0.5 * np.abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    np.testing.assert_allclose(16.0 * area, m.triangle_areas(mesh.vertices, mesh.triangles))


def test_a_revolved_cylinder_has_its_area_and_faces_outwards():
    mesh = m.revolve([(0.0, 0.0), (0.5, 0.0), (0.5, 2.0), (0.0, 2.0)], segments=400)
    area = m.triangle_areas(mesh.vertices, mesh.triangles).sum()
    assert area == pytest.approx(2 * np.pi * 0.5 * 2.0 + 2 * np.pi * 0.25, rel=1e-3)
    assert volume(mesh) == pytest.approx(np.pi * 0.25 * 2.0, rel=1e-3)


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


@pytest.fixture(scope="module")
def cloud():
    return np.random.default_rng(0).uniform(-1.0, 1.0, (20_000, 3)).astype(np.float32)


def test_noise_is_smooth_and_its_frequency_scales():
    line = np.zeros((20_000, 3), np.float32)
    line[:, 0] = np.linspace(0.0, 40.0, 20_000)
    slow, fast = (solid.noise(line, f, 3) for f in (1.0, 4.0))
    assert np.abs(np.diff(slow)).max() < 0.05
    crossings = [np.count_nonzero(np.diff(np.sign(x))) / 2 / 40.0 for x in (slow, fast)]
    assert crossings[0] == pytest.approx(0.36, rel=0.3)
    assert crossings[1] == pytest.approx(4 * 0.36, rel=0.3)


def test_cells_agree_with_a_search_through_all_points(cloud):
    where = cloud[:300]
    near, second, _ = solid.cells(where, 3.0, 5)
    corners = np.array(list(np.ndindex(10, 10, 10))) - 5
    x, y, z, _ = solid._scattered(5, 1.0)
    wrapped = corners % 32
    index = (wrapped[:, 0] * 32 + wrapped[:, 1]) * 32 + wrapped[:, 2]
    seeds = corners + np.column_stack([x[index], y[index], z[index]])
    away = np.sort(np.linalg.norm(where[:, None] * 3.0 - seeds[None], axis=2), axis=1)
    np.testing.assert_allclose(near, away[:, 0], atol=1e-4)
    assert np.mean(np.abs(second - away[:, 1]) < 1e-4) > 0.97  # beyond the neighbouring cells: rare


def test_spots_are_cells_where_they_are_near(cloud):
    near, _, label = solid.cells(cloud, 6.0, 7)
    close, number = solid.spots(cloud, 6.0, 7)
    inside = near < 0.5
    assert inside.mean() > 0.2
    np.testing.assert_allclose(close[inside], near[inside], atol=1e-5)
    np.testing.assert_array_equal(number[inside], label[inside])
    assert (close[~inside] >= 0.5).all()


@pytest.mark.parametrize(
    "paint",
    [minerals.marble, minerals.hammered, minerals.brushed, minerals.patina, minerals.clay,
     minerals.leopard, minerals.leather, minerals.flakes, minerals.swirl],
)  # fmt: skip
def test_painted_stuff_is_in_range_varied_and_without_a_seam(paint):
    points = solid.of_ball(64, 128)
    image, relief, rough = paint(points, 3)
    assert image.shape == (64, 128, 3)
    for picture in (image, relief, rough):
        assert picture.min() >= 0
        assert picture.max() <= 1
    assert image.std() > 0.05
    step = np.abs(np.diff(np.concatenate([image, image[:, :1]], axis=1), axis=1)).mean(axis=(0, 2))
    assert step[-1] < 2.0 * step.mean() + 0.02  # over u = 1 → 0 as elsewhere
