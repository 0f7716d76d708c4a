"""What a linear answer lacks of a large motion goes by the texture, not by the motion's size."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tg4mm.show.measure.limits import missing_share, other_share


def picture(sigma, x):
    """[64, 96, 3] band-limited texture, moved to the right by x pixels exactly."""
    own = gaussian_filter(np.random.default_rng(0).normal(size=(64, 96)), sigma, mode="wrap")
    turned = np.fft.fft(own, axis=1) * np.exp(-2j * np.pi * np.fft.fftfreq(96) * x)
    return np.repeat(0.5 + 0.1 * np.fft.ifft(turned, axis=1).real[..., None] / own.std(), 3, -1)


def linear_answer(sigma, x):
    """Least squares by the gradient of the picture at rest."""
    rest = picture(sigma, 0)
    slope = np.gradient(rest, axis=1)[8:-8, 12:-12]
    return -float((slope * (picture(sigma, x) - rest)[8:-8, 12:-12]).sum() / (slope**2).sum())


@pytest.mark.parametrize(("sigma", "x"), [(1.2, 1.6), (6.0, 2.9), (1.2, -0.6)])
def test_it_is_what_is_missing_of_the_true_motion(sigma, x):
    answer = linear_answer(sigma, x)
    frames = np.stack([picture(sigma, x)] * 2)
    weights = np.zeros((64, 96))
    weights[8:-8, 12:-12] = 1
    share, deviation = missing_share(picture(sigma, 0), frames, np.array([[answer, 0.0]] * 2), weights)
    assert share == pytest.approx(x / answer - 1, abs=0.35 * abs(x / answer - 1) + 0.01)
    assert deviation == 0


def test_blurred_texture_keeps_in_proportion_where_speckle_does_not():
    assert abs(2.9 / linear_answer(6.0, 2.9) - 1) < 0.1 < 1.6 / linear_answer(1.2, 1.6) - 1


@pytest.mark.parametrize("passes", [False, True])
def test_what_passes_is_distinguished_from_motion(passes):
    rng = np.random.default_rng(1)
    frames = np.stack([picture(1.2, x) for x in (0.5, 0.5, 0.4, 0, 0, 0)])
    if passes:
        frames[:3] = picture(1.2, 0)
        frames[:3, 16:48, 30:60] = 0.3
    frames += rng.normal(0, 0.03, frames.shape)
    weights = np.zeros((64, 96))
    weights[8:-8, 12:-12] = 1
    moved = np.array([[0.5, 0.0]] * 3 + [[0.0, 0.0]] * 3)
    share = other_share(picture(1.2, 0), frames, moved, weights)
    assert share > 0.7 if passes else abs(share) < 0.1


def test_of_pictures_in_which_nothing_but_noise_changes_no_share_passes():
    for seed in range(12):
        rng = np.random.default_rng(seed)
        mean = rng.random((40, 40, 3))
        frames = mean + rng.normal(0, 0.05, (12, 40, 40, 3))
        moved = np.concatenate([np.full((6, 2), 0.4), np.zeros((6, 2))])
        assert 0 <= other_share(mean, frames, moved, np.ones((40, 40))) <= 1
