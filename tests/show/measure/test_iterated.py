"""Motion of whole pixels of fine texture is found by iteration, from a linear answer that lacks much of it."""

import numpy as np
import pytest

from benchmarks.calibration.film import FINE, texture
from tg4mm.show.measure.linearity import registered

SIDE, FRAMES = 48, 60


def moving(size_px, seed):
    """Frames of speckle that moves as a whole, by the shift theorem, and its motion about the mean."""
    rng = np.random.default_rng(seed)
    fine = np.fft.rfft2(texture(SIDE, SIDE, rng, 0.35, 0.4, (1.3, 3.0)))
    down, right = (
        2 * np.pi * FINE * np.fft.fftfreq(fine.shape[0])[:, None],
        2 * np.pi * FINE * np.fft.rfftfreq(SIDE * FINE)[None],
    )
    motion = size_px * np.cos(0.7 * np.arange(FRAMES) + 0.3)[:, None] * [0.8, -0.6]
    frames = [np.fft.irfft2(fine * np.exp(-1j * (right * x + down * y))) for x, y in motion]
    small = np.stack([f.reshape(SIDE, FINE, SIDE, FINE).mean((1, 3)) for f in frames])
    small *= 1 + 0.02 * np.sin(np.arange(FRAMES))[:, None, None]  # light
    return small + rng.normal(size=small.shape) * 0.01, motion - motion.mean(0)


@pytest.mark.parametrize("size_px", [0.5, 1.0, 2.0, 3.0])
def test_motion_of_pixels_is_found_from_an_answer_that_lacks_a_third(size_px):
    frames, motion = moving(size_px, round(10 * size_px))
    inside = np.zeros((SIDE, SIDE), bool)
    inside[10:-10, 10:-10] = True
    found = registered(lambda some: frames[some], 0.67 * motion, inside)
    assert (found * motion).sum() / (motion**2).sum() == pytest.approx(1, abs=0.02)
    assert np.sqrt(((found - motion) ** 2).mean() / (motion**2).mean()) < 0.05
