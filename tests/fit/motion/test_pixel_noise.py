"""The noise of every pixel, from the components of time that hold no motion."""

import warnings

import numpy as np
from scipy.ndimage import gaussian_filter

from tests.fit.space.scenes import capture_of
from tests.helpers.motion_temporal import components
from tg4mm.fit.motion.hyperparameters import pixel_noise
from tg4mm.fit.motion.observations import observe
from tg4mm.fit.motion.targets import TargetImages

SIZE, VIEWS = 40, 3
EVENED = 4 * np.pi * 1.5**2  # independent pixels in a Gaussian mean of 1.5 px


def deviation():
    """[V, H, W] standard deviation of a picture's noise: 0.005 to 0.04, smooth, another in every camera."""
    x = np.linspace(0, np.pi, SIZE)
    wave = np.sin(x)[:, None] * np.sin(x)
    return 0.005 + 0.035 * np.stack([wave, wave[::-1, :] ** 2, 1 - wave])


def noisy(states, seed=0, motion=0.0):
    """Components of pictures of 16 bits: grey, noise of known deviation per state, a pattern that swings."""
    rng = np.random.default_rng(seed)
    n_timesteps = len(states)
    noise = rng.normal(size=(states.max() + 1, VIEWS, SIZE, SIZE, 3)) * deviation()[..., None]
    swing = np.sin(2 * np.pi * np.arange(n_timesteps) / n_timesteps)
    pattern = motion * rng.normal(size=(VIEWS, SIZE, SIZE, 3))
    values = 0.5 + noise[states] + swing[:, None, None, None, None] * pattern
    data = np.full((n_timesteps * VIEWS, SIZE, SIZE, 4), 65535, np.uint16)
    data[..., :3] = (values.clip(0, 1) * 65535).round().reshape(-1, SIZE, SIZE, 3)
    ids = list(range(VIEWS)) * n_timesteps
    capture, images = capture_of(ids, sorted(list(range(n_timesteps)) * VIEWS), data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return components(observe(capture, images), 16)


def check(found, freedom, frames_per_state, biased=0.0):
    """Within five standard errors of a mean over `freedom` × three channels × the pixels that are evened out.

    The mean of all pixels has √(pixels) times less, and tells a wrong number of degrees of freedom.
    """
    true = frames_per_state * gaussian_filter(deviation() ** 2, (0, 1.5, 1.5), mode="reflect")
    error = found / true - 1
    one = np.sqrt(2 / (3 * freedom * EVENED))
    assert np.abs(error[:, 5:-5, 5:-5]).max() < 5 * one + biased
    whole = np.sqrt(2 / (3 * freedom * error.size)) * 1.5  # 1.5: pixels of large noise weigh more
    assert abs(found.sum() / true.sum() - 1) < 4 * whole + biased
    assert np.abs(0.8 * found.sum() / true.sum() - 1) > 4 * whole + biased  # it can fail


class TestNoiseOfKnownVariance:
    def test_beside_motion_what_is_left_tells(self):
        """A component of motion, eight times the noise, is kept and not named noise: 28 are left."""
        found = noisy(np.arange(30), motion=0.08)
        assert len(found.basis) == 1
        variance = pixel_noise(found, np.array([False]))
        check(variance, 28, 1)
        assert pixel_noise(found, np.array([True])).mean() > 3 * variance.mean()


class TestExactly:
    def test_energy_is_divided_among_kept_and_left_out(self):
        """Made up: residual 6 of rank 5 with two kept, the second of energy 2 in one pixel, before evening out."""
        images = np.zeros((1, 2, 9, 9, 3), np.float32)
        images[0, 1] = np.sqrt(2.0)
        images[0, 0] = 100.0
        targets = TargetImages(
            np.zeros((2, 8)), np.zeros(8), images, np.full((1, 9, 9), 6.0, np.float32), 5, images[:, 0]
        )
        np.testing.assert_allclose(
            pixel_noise(targets, np.array([False, True])), (6 + 2) / (3 + 1), rtol=1e-5
        )
        np.testing.assert_allclose(pixel_noise(targets, np.array([False, False])), 6 / 3, rtol=1e-5)
