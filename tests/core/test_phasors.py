"""Single figures of many phasors."""

import numpy as np

from tg4mm.core.phasors import main_direction, peak_displacement, scale_top


def test_peak_displacement_is_the_greatest_length_over_a_period():
    rng = np.random.default_rng(0)
    phasors = rng.normal(size=(50, 3)) + 1j * rng.normal(size=(50, 3))
    turns = np.exp(1j * np.linspace(0, 2 * np.pi, 2000))
    lengths = np.linalg.norm((phasors[:, None] * turns[:, None]).real, axis=2)
    np.testing.assert_allclose(peak_displacement(phasors), lengths.max(1), rtol=1e-5)


def test_main_direction_ignores_phase_and_sign():
    axis = np.array([0.6, 0.0, -0.8])
    phasors = np.exp(1j * np.arange(7))[:, None] * axis
    np.testing.assert_allclose(main_direction(phasors, np.ones(7)), -axis, atol=1e-12)


def test_the_top_of_a_scale_ignores_what_has_little_weight():
    values = np.array([1.0, 2.0, 3.0, 1000.0])
    assert scale_top(values, np.array([1.0, 1.0, 1.0, 0.001])) == 3.0
    assert scale_top(values) == 1000.0
    assert scale_top(values, np.zeros(4)) == 0.0
