"""Timesteps taken together: those at which things stand nearly alike, with the mean of their pictures."""

from __future__ import annotations

import numpy as np
import pytest

from tests.fit.space.scenes import capture_of
from tg4mm.fit.motion.observations import observe
from tg4mm.fit.motion.states import MOST, most_states, state_pictures, states_of

T = 30


def _basis(cycles: float) -> np.ndarray:
    angle = 2 * np.pi * cycles * np.arange(T) / T
    return np.stack([np.sin(angle), np.cos(angle)])


def test_a_vibration_passes_the_same_places_over_and_over() -> None:
    states = states_of(_basis(5), np.array([10.0, 10.0]))
    assert len(states.gains) == 6
    np.testing.assert_array_equal(states.of[:6], states.of[6:12])
    np.testing.assert_array_equal(states.count, 5)


def test_what_moves_by_little_is_one_state() -> None:
    assert len(states_of(_basis(5), np.array([0.01, 0.01])).gains) == 1


def test_gains_are_the_mean_of_the_timesteps_and_add_up_to_nothing() -> None:
    basis = _basis(4)
    states = states_of(basis, np.array([3.0, 3.0]), most=5)
    assert len(states.gains) == 5
    for k in range(5):
        np.testing.assert_allclose(states.gains[k], basis[:, states.of == k].mean(1))
    np.testing.assert_allclose(states.gains.T @ states.count, 0, atol=1e-12)


def test_products_of_all_states_are_those_of_all_timesteps() -> None:
    """The identity, too, of a sinusoid that no state shows."""
    basis = np.concatenate([_basis(5), _basis(3)]) * np.sqrt(2 / T)
    states = states_of(basis, np.array([8.0, 8.0, 0.12, 0.12]))
    assert len(states.gains) == 6
    np.testing.assert_allclose(states.products.sum(0), np.eye(4), atol=1e-12)
    shown = states.sums.T @ states.gains
    np.testing.assert_allclose(np.diag(shown), [1, 1, 0, 0], atol=1e-12)


def test_pictures_are_the_mean_of_their_timesteps() -> None:
    rng = np.random.default_rng(0)
    data = rng.integers(0, 256, (T, 5, 4, 4), np.uint8)
    data[..., 3] = 255
    capture, images = capture_of([0] * T, list(range(T)), data)
    states = states_of(_basis(5), np.array([10.0, 10.0]))
    found = state_pictures(observe(capture, images), states)
    assert found.shape == (1, 6, 5, 4, 3)
    for k in range(6):
        np.testing.assert_allclose(found[0, k], data[states.of == k, ..., :3].mean(0) / 255, atol=1e-5)


@pytest.mark.parametrize(
    ("views", "size", "expected"), [(12, (64, 64), MOST), (30, (512, 512), 11), (500, (2048, 2048), 3)]
)
def test_large_pictures_have_fewer_states(views: int, size: tuple[int, int], expected: int) -> None:
    assert most_states(views, size) == expected
