"""Meshes, sheets, solids and patterns in space: areas and volumes in closed form, outwards, where they should be."""

import numpy as np
import pytest

from dataset_gen import meshes as m
from dataset_gen.patterns import minerals, solid
from dataset_gen.shapes import drums, solids
from dataset_gen.shapes.sheet import Outline, frames_on, moulding, puff, rounded, sheet
from tests.dataset_gen.builtin import open_edges, volume

PATH = np.column_stack([np.zeros(9), np.zeros(9), np.linspace(0.0, 3.0, 9)])
ROUND = m.circle(1.0, 400)
ARC = np.column_stack([np.cos(turn := np.linspace(0.5, 2.0, 200)), np.sin(turn)])
RIM = Outline(1.0, 1.0, 2.0).rim(300)


def test_a_sheet_round_an_axis_is_a_sphere():
    height = np.linspace(-np.pi / 2, np.pi / 2, 60)[:, None]
    turn = np.linspace(0, 2 * np.pi, 80, endpoint=False)
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


@pytest.fixture(scope="module")
def cloud():
    return np.random.default_rng(0).uniform(-1.0, 1.0, (20_000, 3)).astype(np.float32)


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
