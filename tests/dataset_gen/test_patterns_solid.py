"""Patterns in space: statistics, cells against a plain search, ranges of the painted stuffs."""

import numpy as np
import pytest

from dataset_gen.patterns import minerals, solid


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
