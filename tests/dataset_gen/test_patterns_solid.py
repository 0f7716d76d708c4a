"""Patterns in space: statistics, cells against a plain search, ranges of the painted stuffs."""

import numpy as np
import pytest

from dataset_gen.patterns import brocade, minerals, skins, solid, timber, unroll


@pytest.fixture(scope="module")
def cloud():
    return np.random.default_rng(0).uniform(-1.0, 1.0, (20_000, 3)).astype(np.float32)


def test_noise_has_mean_zero_and_deviation_one(cloud):
    for pattern in (solid.noise(cloud, 9.0, 1), solid.fractal(cloud, 6.0, 3, 2)):
        assert abs(pattern.mean()) < 0.1
        assert pattern.std() == pytest.approx(1.0, abs=0.2)


def test_noise_is_smooth_and_its_frequency_scales():
    line = np.zeros((20_000, 3), np.float32)
    line[:, 0] = np.linspace(0.0, 40.0, 20_000)
    slow, fast = (solid.noise(line, f, 3) for f in (1.0, 4.0))
    assert np.abs(np.diff(slow)).max() < 0.05
    crossings = [np.count_nonzero(np.diff(np.sign(x))) / 2 / 40.0 for x in (slow, fast)]
    assert crossings[0] == pytest.approx(0.36, rel=0.3)
    assert crossings[1] == pytest.approx(4 * 0.36, rel=0.3)


def test_seeds_give_different_noise(cloud):
    fields = [solid.noise(cloud, 5.0, seed) for seed in range(8)]
    for i, one in enumerate(fields):
        for two in fields[:i]:
            assert abs(np.corrcoef(one, two)[0, 1]) < 0.2


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


def test_ramp_step_and_mix():
    stops = [(0.0, (0.0, 0.5, 1.0)), (1.0, (1.0, 0.5, 0.0))]
    np.testing.assert_allclose(
        solid.ramp(np.array([-1.0, 0.25, 2.0]), stops), [[0, 0.5, 1], [0.25, 0.5, 0.75], [1, 0.5, 0]]
    )
    np.testing.assert_allclose(solid.step(np.array([0.0, 1.5, 3.0]), 1.0, 2.0), [0, 0.5, 1])
    np.testing.assert_allclose(solid.step(np.array([0.0, 3.0]), 2.0, 1.0), [1, 0])
    np.testing.assert_allclose(
        solid.mix(np.zeros((2, 3)), (1.0, 2.0, 3.0), np.array([0.0, 0.5])), [[0, 0, 0], [0.5, 1, 1.5]]
    )


@pytest.mark.parametrize(
    "paint",
    [minerals.marble, minerals.hammered, minerals.brushed, minerals.patina, minerals.clay,
     skins.leopard, skins.leather, skins.flakes, skins.swirl],
)  # fmt: skip
def test_painted_stuff_is_in_range_varied_and_without_a_seam(paint):
    points = unroll.of_ball(64, 128)
    image, relief, rough = paint(points, 3)
    assert image.shape == (64, 128, 3)
    for picture in (image, relief, rough):
        assert picture.min() >= 0
        assert picture.max() <= 1
    assert image.std() > 0.05
    step = np.abs(np.diff(np.concatenate([image, image[:, :1]], axis=1), axis=1)).mean(axis=(0, 2))
    assert step[-1] < 2.0 * step.mean() + 0.02  # over u = 1 → 0 as elsewhere


def test_wood_runs_along_its_axis():
    points = unroll.of_grid(np.array([[[0, 0, 0], [1, 0, 0]], [[0, 0, 1], [1, 0, 1]]], float), 200, 200)
    image, pores = timber.wood(points, 20.0, timber.HONEY, 1)
    grey = image.mean(-1)
    assert np.abs(np.diff(grey, axis=1)).mean() > 2.0 * np.abs(np.diff(grey, axis=0)).mean()
    assert 0.0 <= pores.min() <= pores.max() <= 1.0


def test_damask_repeats_and_covers_part_of_the_cloth():
    b, a = np.meshgrid(
        np.linspace(0, 0.6, 240, endpoint=False), np.linspace(0, 0.4, 160, endpoint=False), indexing="ij"
    )
    mask = brocade.damask(a, b, (0.2, 0.3))
    assert 0.1 < mask.mean() < 0.6
    np.testing.assert_allclose(mask[:120], mask[120:], atol=1e-6)
    np.testing.assert_allclose(mask[:, :80], mask[:, 80:], atol=1e-6)


def test_cord_is_twisted_in_two_colours():
    image, ridge = brocade.cord(
        256, 32, 10, ((0.5, 0.4, 0.1), (1.0, 0.8, 0.4)), ((0.0, 0.2, 0.1), (0.2, 0.5, 0.3)), 1
    )
    assert image[..., 0].max() > 0.8
    assert image[..., 0].min() < 0.2
    assert 0.0 <= ridge.min() <= ridge.max() <= 1.0
