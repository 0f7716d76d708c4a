"""The calibration's films are what they say, its scores count rightly, and three films go through it."""

import numpy as np
import pytest

from benchmarks.calibration.__main__ import scored
from benchmarks.calibration.draw import FilmTruth, TrueVibration, make_film, read_truth
from benchmarks.calibration.film import FilmMode, Layer, texture
from benchmarks.calibration.score import Named, score, smallest_found, table
from benchmarks.calibration.special import make_large_film, make_plain_film

TRUTH = FilmTruth(320, 180, 30, 300, 3.0, "libx264", 1.0)


def truth(*vibrations):
    return FilmTruth(**{**TRUTH.__dict__, "vibrations": list(vibrations)})


def steady(hz, size):
    return TrueVibration(hz, (size, 0.0), (100, 50, 200, 100), False, 0.0)


def test_a_layer_moved_by_a_whole_pixel_in_steps_is_the_layer_shifted():
    """Six tenths and back: the Taylor series is exact to a thousandth of the texture's contrast."""
    cloth = texture(48, 48, np.random.default_rng(0), 0.3, 0.4, (1.5, 4.0))
    still = Layer(cloth, None, [], 0.6)
    shape = np.broadcast_to([1.0, 0.0], (48, 48, 2))
    fine_right = Layer(np.roll(cloth, 1, axis=1), None, [], 0.6).rest[0]  # by a third of a pixel
    moved = Layer(cloth, None, [FilmMode(shape, lambda t: 1 / 3)], 0.6).drawn(0.0, np.zeros(2))[0]
    inside = (slice(10, 38), slice(10, 38))
    assert np.abs(moved - fine_right)[inside].max() < 2e-3 * still.rest[0][inside].std()


def test_a_line_within_its_deviation_counts_and_another_is_false():
    found = score(
        truth(steady(5.0, 0.2), steady(9.0, 0.05)),
        [Named(5.0022, 0.001, 0.212, 0.01, centre_px=(150, 75)), Named(12.0, 0.01, 0.1, 0.01)],
        1.0,
    )
    assert found.frequencies == [pytest.approx(2.2)]
    assert found.amplitudes == [pytest.approx(1.2)]
    assert found.found == [(0.2, True), (0.05, False)]
    assert found.strongest_named
    assert len(found.false) == 1
    assert "| frequencies | 0% | 0% | 2.2 | 1 |" in table([found])
    assert "| amplitudes | 0% | 100% | 1.2 | 1 |" in table([found])


def test_a_marked_line_is_no_false_one_and_another_place_gives_no_amplitude():
    named = [Named(12.0, 0.01, 0.1, 0.01, marked=True), Named(5.0, 0.01, 0.3, 0.01, centre_px=(20, 20))]
    found = score(truth(steady(5.0, 0.2)), named, 1.0)
    assert (found.false, found.marked) == ([], 1)
    assert found.amplitudes == []
    assert found.frequencies == [0.0]


def test_recall_by_amplitude_finds_where_nine_of_ten_are_named():
    rng = np.random.default_rng(0)
    sizes = np.exp(rng.uniform(np.log(0.01), np.log(0.5), 4000))
    chance = 1 / (1 + np.exp(-3 * (np.log(sizes) - np.log(0.05))))
    words = smallest_found([(float(a), bool(rng.random() < c)) for a, c in zip(sizes, chance, strict=True)])
    at = float(words.split("from ")[1].split()[0])
    assert at == pytest.approx(0.05 * np.exp(np.log(9) / 3), rel=0.1)


@pytest.mark.slow
def test_three_films_from_nothing_to_scores(tmp_path):
    """Seeds of films with a clear vibration or none: what is named is there, within four of its ±."""
    scores = [scored(seed, tmp_path, ("look",), "")["look"] for seed in (0, 2, 3)]
    assert all(not s.false for s in scores)
    assert all(abs(z) < 4 for s in scores for z in (*s.frequencies, *s.amplitudes, *s.dampings))
    again = read_truth(tmp_path / "0000.json")
    assert again == make_film(0, tmp_path)
    assert "films on which nothing vibrates with a line: 0" in table(scores)
    still = scored(3, tmp_path / "plain", ("look",), "", make_plain_film)["look"]
    assert (still.is_still, still.false) == (True, [])
    large = scored(6, tmp_path / "large", ("look",), "", make_large_film)["look"]  # 2.7 and 1.3 px
    assert len(large.amplitudes) == 2
    assert max(map(abs, large.amplitudes)) < 2
    assert large.false == []
