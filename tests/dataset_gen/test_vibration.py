"""Mode shapes, motion states, and the law that ties them to time and magnification."""

import numpy as np
import pytest

from dataset_gen.vibration import Cantilever, Mode, Motion, State, mode_shapes

FIELD = Cantilever(base_z=-0.3, length=0.5, direction=(3.0, 4.0))


def points(count=200, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (count, 3))


def motion(fields, phasors, frequencies, fps=30.0):
    modes = [
        Mode(str(i), f, 0.01, field, p)
        for i, (field, p, f) in enumerate(zip(fields, phasors, frequencies, strict=True))
    ]
    rest = points()
    return mode_shapes(modes, [(rest, np.ones(len(rest)))]), frequencies, fps


class Spin:
    """A complex field: circular orbits."""

    kind = "orbit"

    def __call__(self, points):
        return np.outer(1.0 + points[:, 0] ** 2, [1.0, 1j, 0.0])


def test_cantilever_is_zero_at_and_below_the_clamp_and_one_at_the_tip():
    deflection, slope = FIELD.profile(np.array([-1.0, -0.3, 0.2]))
    np.testing.assert_array_equal(deflection[:2], 0.0)
    np.testing.assert_array_equal(slope[:2], 0.0)
    assert deflection[2] == pytest.approx(1.0, abs=1e-9)
    below = points() * [1, 1, 0.5] - [0, 0, 0.8]
    np.testing.assert_array_equal(FIELD(below), 0.0)


def test_cantilever_slope_is_the_derivative_of_its_deflection():
    z = np.linspace(-0.25, 0.6, 50)
    step = 1e-6
    numeric = (FIELD.profile(z + step)[0] - FIELD.profile(z - step)[0]) / (2 * step)
    np.testing.assert_allclose(FIELD.profile(z)[1], numeric, atol=1e-7)


def test_cantilever_obeys_the_beam_equation():
    # EI w'''' = ω² m w, so the fourth derivative is (β/L)⁴ w all along the beam.
    h = 0.01
    z = np.linspace(-0.25, 0.15, 20)
    stencil = sum(
        c * FIELD.profile(z + k * h)[0] for k, c in zip(range(-2, 3), (1, -4, 6, -4, 1), strict=True)
    )
    np.testing.assert_allclose(
        stencil / h**4, (1.8751040687 / 0.5) ** 4 * FIELD.profile(z)[0], rtol=2e-3, atol=0.05
    )


def test_what_stands_on_the_beam_turns_rigidly():
    high = points() * [0.5, 0.5, 0.2] + [0, 0, 0.6]
    moved = FIELD(high)
    # A small rigid motion has an antisymmetric gradient: distances change in second order only.
    a, b = high[:100], high[100:]
    stretch = ((a - b) * (moved[:100] - moved[100:])).sum(1)
    np.testing.assert_allclose(stretch, 0.0, atol=1e-12)


def test_the_largest_displacement_of_the_scene_is_the_amplitude():
    parts = [(points(50, 1), np.ones(50)), (points(70, 2), np.full(70, 0.5))]
    shapes = mode_shapes([Mode("bending", 5.0, 0.004, FIELD)], parts)
    peaks = [np.linalg.norm(np.abs(shape[0]), axis=1).max() for shape in shapes]
    assert max(peaks) == pytest.approx(0.004)
    held = mode_shapes([Mode("bending", 5.0, 0.004, FIELD)], [parts[0], (points(70, 2), np.zeros(70))])
    np.testing.assert_array_equal(held[1], 0.0)


def test_a_mode_that_moves_nothing_is_refused():
    with pytest.raises(ValueError, match="'bending' moves no vertex"):
        mode_shapes([Mode("bending", 5.0, 0.004, FIELD)], [(points() - [0, 0, 2], np.ones(200))])


@pytest.mark.parametrize("alpha", [0.0, 5.0, 0.5])
def test_displacement_is_the_law_of_the_contract(alpha):
    shapes, frequencies, fps = motion([FIELD, Spin()], [-1j, 0.6 + 0.8j], [5.0, 3.7])
    m = Motion(shapes, frequencies, fps)
    for t in (0, 1, 7, 29):
        turn = np.exp(2j * np.pi * np.array(frequencies) * t / fps)
        expected = (1 + alpha) * np.tensordot(turn, shapes[0], axes=1).real
        np.testing.assert_allclose(m.displacement(0, m.state(t, alpha)), expected, atol=1e-10)


def test_displacement_is_linear_in_the_gain():
    shapes, frequencies, fps = motion([FIELD], [-1j], [5.0])
    m = Motion(shapes, frequencies, fps)
    one = m.displacement(0, State((1.0,)))
    np.testing.assert_array_equal(m.displacement(0, State((-8.0,))), -8.0 * one)


def test_a_sine_is_at_rest_in_the_reference_frame_for_every_alpha():
    shapes, frequencies, fps = motion([FIELD], [-1j], [5.0])
    m = Motion(shapes, frequencies, fps)
    assert m.state(0) == m.state(0, 50.0)
    assert m.state(0).at_rest
    assert not m.state(1).at_rest
    np.testing.assert_array_equal(m.displacement(0, m.state(0)), 0.0)


def test_states_that_look_the_same_are_equal():
    shapes, frequencies, fps = motion([FIELD], [-1j], [5.0])
    m = Motion(shapes, frequencies, fps)
    assert len({m.state(t) for t in range(30)}) == 3
    assert len({m.state(t, a) for t in range(30) for a in (0, 5, 10, 20, 50)}) == 11
    shapes, frequencies, fps = motion([Spin()], [1.0], [5.0])
    orbit = Motion(shapes, frequencies, fps)
    assert len({orbit.state(t) for t in range(30)}) == 6  # an orbit passes no point twice in a period
