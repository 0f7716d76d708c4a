"""A frequency is exact where frames lose motion by their position between predicted ones."""

import numpy as np
import pytest

from tg4mm.capture.look.order import alike_by_position
from tg4mm.capture.look.reading import BETWEEN, FORWARD, INTRA
from tg4mm.core.lines import fit_lines

TIMES, FRAMES = np.arange(240) / 30, np.arange(240)


def coded(hz, shares, seed=0, noise=0.02):
    """A tone of which each position keeps its share, and the kinds of frames, one of each four predicted forwards."""
    series = np.cos(2 * np.pi * hz * TIMES + 0.3) * np.array(shares)[FRAMES % 4]
    kinds = np.where(FRAMES % 4 == 0, FORWARD, BETWEEN)
    kinds[0] = INTRA
    return series + noise * np.random.default_rng(seed).normal(size=240), kinds


def fitted(series, kinds, hz):
    alike = alike_by_position(series, TIMES, kinds, hz)
    line = fit_lines(alike.series, TIMES, [alike.hz]).lines[0]
    return line, line.hz_deviation * alike.wider**0.5


@pytest.mark.parametrize(("hz", "mended"), [(3.7, True), (7.45, True), (3.67, False), (5.1, False)])
def test_an_unresolved_image_does_not_shift_the_frequency(hz, mended):
    pulls, plain = [], []  # errors over their deviations
    for seed in range(30):
        series, kinds = coded(hz, (1, 0.85, 0.95, 0.88), seed)
        line, deviation = fitted(series, kinds, hz + 0.002)
        pulls.append((line.hz - hz) / deviation)
        one = fit_lines(series, TIMES, [hz]).lines[0]
        plain.append((one.hz - hz) / one.hz_deviation)
    assert abs(np.mean(pulls)) < 4 / 30**0.5
    assert 0.6 < np.std(pulls) < 1.5
    assert (abs(np.mean(plain)) > 1) == mended


def test_far_from_images_the_deviation_stays():
    series, kinds = coded(5.1, (1, 0.9, 0.95, 0.9))
    assert alike_by_position(series, TIMES, kinds, 5.1).wider == pytest.approx(1, abs=0.05)


def test_without_b_frames_nothing_changes():
    series, kinds = coded(3.7, (1, 1, 1, 1))
    assert alike_by_position(series, TIMES, np.full_like(kinds, FORWARD), 3.7)[1:] == (3.7, 1.0)


def test_what_b_frames_alone_show_is_left_as_it_is():
    series, kinds = coded(3.7, (0.1, 1, 1, 1))
    assert alike_by_position(series, TIMES, kinds, 3.7).series is series
