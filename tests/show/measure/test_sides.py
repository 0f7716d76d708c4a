"""What a pass through the pictures keeps in a byte for each number: sums over a region are what they were."""

import numpy as np
import pytest

from tg4mm.show.measure.kept import Sides

N, FRAMES = 400, 60
SEEN = np.arange(50, 350)


@pytest.fixture
def exact():
    """Noise of very different sizes from Gaussian to Gaussian; a quarter of them is not seen."""
    rng = np.random.default_rng(0)
    out = np.zeros((2, FRAMES, N, 6), np.float32)
    sizes = 10 ** rng.uniform(-3, 3, size=(len(SEEN), 6))
    out[:, :, SEEN] = rng.normal(size=(2, FRAMES, len(SEEN), 6)) * sizes
    return out


def motions(rows):
    out = np.zeros((6, N, 6), np.float32)
    out[:, rows] = np.random.default_rng(1).normal(size=(6, len(rows), 6))
    return out


@pytest.mark.parametrize("rows", [np.arange(60, 65), np.arange(0, 200), np.arange(N)])
def test_rounding_adds_a_ten_thousandth_of_the_variance(exact, rows):
    e = motions(rows)
    expected = np.einsum("knc,hfnc->hfk", e.astype(float), exact)
    error = Sides.of(exact).summed(e, rows) - expected
    assert 0 < (error**2).mean() < 2e-4 * (expected**2).mean()
