"""Intervals hold the true mean as often as they say, however few the scenes."""

import numpy as np
import pytest

from tg4mm.research.bench.means import half_width, less, line_means
from tg4mm.research.bench.pages.tables import differences_tables, pivots


@pytest.mark.parametrize(("n_scenes", "between"), [(2, 1.0), (3, 0.3), (8, 1.0)])
def test_nineteen_of_twenty_intervals_hold_the_mean(n_scenes, between):
    """Three seeds a scene; a scene differs from the mean by `between`, a seed from its scene by 1, both normal."""
    rng = np.random.default_rng(7)
    scenes = [f"scene {i}" for i in range(n_scenes) for _ in range(3)]
    held = 0
    for _ in range(800):
        values = np.repeat(between * rng.normal(size=n_scenes), 3) + rng.normal(size=3 * n_scenes)
        held += abs(values.mean()) <= half_width(values, scenes)
    assert held / 800 > 0.935


def test_seeds_of_one_scene_are_drawn_by_themselves_and_one_value_tells_nothing():
    assert half_width([0.9], ["mic"]) is None
    assert half_width([0.5, 0.5, 0.5], ["mic"] * 3) == 0
    # t at two degrees of freedom times the standard error
    values = [1.0, 2.0, 4.0]
    expected = 4.303 * np.std(values, ddof=1) / np.sqrt(3)
    assert half_width(values, ["mic"] * 3) == pytest.approx(expected, rel=0.03)


def test_tables_have_the_interval_of_a_mean_and_of_the_difference_on_each_set():
    sets = {"mic_s0": "mic", "mic_s1": "mic", "ship_s0": "ship", "ship_s1": "ship"}
    scores = {"modal": (0.9, 0.91, 0.8, 0.82), "linear-2d": (0.89, 0.9, 0.79, 0.81)}
    lines = [
        {"set": label, "row": row, "alphas": {"20": {"ssim": value}}, "frames_per_s": None}
        for row, values in scores.items()
        for label, value in zip(sets, values, strict=True)
    ]
    groups = dict.fromkeys(sets, "all")
    (table,) = pivots(line_means(lines, groups, sets), "all")
    half = half_width(scores["modal"], list(sets.values()))
    assert table.rows[0] == ["modal", f"0.8575 ± {half:.4f}"]
    results = {"differences": line_means(less(lines, "modal"), groups, sets), "against": "modal"}
    (table,) = differences_tables(results, "all")
    assert table.rows == [["linear-2d", "-0.0100 ± 0.0000"]]
