"""Folds of the data, and what two of them agree on: noise shrinks, motion stays, the deviation is the noise's."""

import numpy as np
import pytest

from tg4mm.fit.motion.prior import nearest
from tg4mm.fit.motion.split_half import LEAST, deviation, folds_of, reliability, wiener_shrink

SIGMA = 0.3
SIZE = (80, 48)


@pytest.mark.parametrize("n", [LEAST, LEAST + 1, 30])
def test_many_cameras_are_halved_by_camera(n):
    a, b = folds_of(n, SIZE, False)
    assert a.pixels is b.pixels is None
    assert sorted([*a.views, *b.views]) == list(range(n))
    assert abs(len(a.views) - len(b.views)) <= 1
    assert (np.diff(a.views) == 2).all()  # neighbours on the orbit part


@pytest.mark.parametrize("n", [1, LEAST - 1])
def test_few_cameras_are_halved_by_pixels(n):
    a, b = folds_of(n, SIZE, False)
    assert list(a.views) == list(b.views) == list(range(n))
    np.testing.assert_array_equal(a.pixels + b.pixels, 1)
    assert a.pixels.mean() == pytest.approx(0.5, abs=0.01)


def test_a_moving_cameras_frames_are_halved_by_time():
    a, b = folds_of(21, SIZE, True)
    assert list(a.views) == list(range(10))
    assert list(b.views) == list(range(10, 21))


def fields(seed=0, n=3000):
    """(truth, whole, a, b, means): one component moves, one is noise alone; `whole` is the halves' mean."""
    rng = np.random.default_rng(seed)
    means = rng.random((n, 3))
    truth = np.zeros((2, n, 3))
    truth[0] = (0.3, -0.3, 0.2)
    a, b = (truth + SIGMA * rng.normal(size=truth.shape) for _ in range(2))
    return truth, (a + b) / 2, a, b, means


def test_the_gain_is_wieners():
    """S / (S + N) with the power of the motion and of the noise in `whole`, which no other gain betters."""
    truth, whole, a, b, _ = fields(n=6000)
    signal, noise = 0.22, 3 * SIGMA**2 / 2
    gain = reliability(whole, a, b)[0]
    assert gain == pytest.approx(signal / (signal + noise), abs=0.01)
    error = {g: np.linalg.norm(g * whole[0] - truth[0]) for g in (gain - 0.05, gain, gain + 0.05)}
    assert min(error, key=lambda g: error[g]) == gain


def test_the_deviation_is_that_of_the_noise_in_the_whole():
    """Here three times as strong on one side as on the other."""
    truth, _, a, b, means = fields()
    uneven = np.where(means[:, :1] < 0.5, 1.0, 3.0)
    a, b = (truth + (x - truth) * uneven for x in (a, b))
    found = deviation(a, b, nearest(means)[1])
    for side in (means[:, 0] < 0.4, means[:, 0] > 0.6):
        error = ((a + b) / 2 - truth)[:, side]
        expected = np.sqrt((error**2).sum((0, 2)).mean())
        np.testing.assert_allclose(np.sqrt((found[side] ** 2).mean()), expected, rtol=0.05)


def test_shrinking_is_the_mean_times_the_gain_of_displacement():
    """Rotations go along with it."""
    _, _, a, b, _ = fields(n=200)
    halves = np.stack([np.concatenate([x, 5 * x], 2) for x in (a, b)])
    shrunk, gain = wiener_shrink(halves)
    np.testing.assert_allclose(gain, reliability((a + b) / 2, a, b))
    np.testing.assert_allclose(shrunk, gain[:, None, None] * halves.mean(0), rtol=1e-6)
