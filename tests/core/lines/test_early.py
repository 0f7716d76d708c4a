"""The ± of a decay: as large as its errors where a ring-down is one exponential, and where its weak end is lost."""

import numpy as np
import pytest

from tg4mm.core.lines import find_lines

T = np.arange(480) / 120


def scores(loss, n=60):
    """(decay − true) / ± over random ring-downs of which `loss`, a share of the first amplitude, is half lost."""
    out = []
    for seed in range(n):
        rng = np.random.default_rng(seed)
        decay, hz = 0.55 + rng.uniform(0, 0.9), rng.uniform(5, 30)
        envelope = np.exp(-decay * T)
        envelope *= envelope**2 / (envelope**2 + loss**2)
        y = envelope * np.cos(2 * np.pi * hz * T + rng.uniform(0, 6)) + rng.normal(0, 0.02, len(T))
        line = find_lines(y, T, most=1).lines[0]
        out.append((line.decay_per_s - decay) / np.sqrt(line.covariance[1, 1]))
    return np.array(out)


def test_of_one_exponential_the_deviation_stays_true():
    found = np.abs(scores(0.0))
    assert 0.55 < (found < 1).mean() < 0.82
    assert (found < 2).mean() > 0.88
    assert found.max() < 4


@pytest.mark.parametrize("loss", [0.1, 0.2])
def test_where_small_motion_is_lost_the_deviation_says_so(loss):
    assert np.abs(scores(loss)).max() < 3.5
