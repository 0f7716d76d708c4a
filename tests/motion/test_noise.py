"""What is noise: components that two halves of the cameras do not agree on, and pixels that flicker."""

from __future__ import annotations

import numpy as np
import pytest

from tests.motion.test_weight import CAMERAS, PARTS, as_one, made, shown
from tg4mm.motion.pictures.differences import TemporalComponents
from tg4mm.motion.posing.noise import LOOSE, noise_components, pixel_weights
from tg4mm.motion.solver.device import DeviceProblem
from tg4mm.motion.solver.problem import MotionProblem


@pytest.fixture(scope="module")
def loose() -> MotionProblem:
    (problem,) = made([LOOSE])
    return problem


@pytest.mark.parametrize("at_once", [1, 8])
@pytest.mark.parametrize("device", [None, "cpu"])
def test_noise_is_told_from_motion(loose: MotionProblem, at_once: int, device: str | None) -> None:
    """Motion with as much noise as signal, noise alone of the same energy, motion without noise."""
    moving = shown(loose, as_one(), 1.0)
    noise = np.random.default_rng(3).normal(0, np.sqrt((moving**2).mean()), moving.shape).astype(np.float32)
    images = np.stack([moving, noise, shown(loose, as_one()[:, ::-1].copy(), 0.0)], 1)
    problem = loose if device is None else DeviceProblem(loose, device)
    found = noise_components(problem, PARTS, images, at_once)
    np.testing.assert_array_equal(found, [False, True, False])


def test_the_strongest_component_is_never_noise(loose: MotionProblem) -> None:
    noise = np.random.default_rng(3).normal(size=(CAMERAS, 2, *loose.views[0].transmittance.shape, 3))
    np.testing.assert_array_equal(noise_components(loose, PARTS, noise.astype(np.float32), 8), [False, True])


def components(images: np.ndarray, residual: np.ndarray) -> TemporalComponents:
    n = images.shape[1]
    return TemporalComponents(np.eye(n, 10), np.ones(10), images, residual, rank=n, mean=images[:, 0])


def test_pixels_count_less_the_more_they_flicker() -> None:
    """The left half flickers three times as much as the right: 1 / (1 + 9/5) and 1 / (1 + 1/5); the mean is 5."""
    rng, size = np.random.default_rng(0), (2, 2, 60, 80, 3)
    images = rng.normal(size=size).astype(np.float32)
    images[:, 1, :, :40] *= 3
    weights = pixel_weights(components(images, np.zeros((2, 60, 80), np.float32)), np.array([False, True]))
    assert weights is not None
    assert weights.dtype == np.float32
    assert weights[:, :, 5:35].mean() == pytest.approx(1 / (1 + 9 / 5), rel=0.1)
    assert weights[:, :, 45:75].mean() == pytest.approx(1 / (1 + 1 / 5), rel=0.1)
    assert 0 < weights.min() < weights.max() <= 1


def test_where_nothing_is_noise_all_pixels_are_alike() -> None:
    images = np.ones((2, 1, 6, 8, 3), np.float32)
    assert pixel_weights(components(images, np.zeros((2, 6, 8), np.float32)), np.array([False])) is None
