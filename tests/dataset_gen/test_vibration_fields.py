"""Displacement fields: clamped where they say so, rigid where they say so, and solutions of their equations."""

import numpy as np
import pytest

from dataset_gen.vibration import reach
from dataset_gen.vibration.fields import Rock, Twist, phasor
from dataset_gen.vibration.structures import BallRegion, Bending, Membrane, Plate, Wave, bessel_zero

BASE, TIP = np.array([0.2, -0.1, -0.3]), np.array([0.5, 0.2, 0.4])
LENGTH = float(np.linalg.norm(TIP - BASE))
AXIS = (TIP - BASE) / LENGTH
BETAS = (1.8751040687, 4.6940911330, 7.8547574382)


def points(count=200, seed=0, low=-1.0, high=1.0):
    return np.random.default_rng(seed).uniform(low, high, (count, 3))


def beam(order=1, direction=(1.0, 0.0, 0.0)):
    return Bending(tuple(BASE), tuple(TIP), direction, order)


def stretch(field, where):
    """First-order change of half the squared distances of pairs of points; 0 for a rigid motion."""
    moved = field(where)
    half = len(where) // 2
    return ((where[:half] - where[half:]) * (moved[:half] - moved[half:])).sum(1)


def derivative(f, x, h=1e-3, order=2):
    """Central difference, second derivative of fourth-order accuracy, or fourth derivative."""
    weights = {2: ((-1 / 12, 4 / 3, -5 / 2, 4 / 3, -1 / 12), 2), 4: ((1, -4, 6, -4, 1), 4)}[order]
    return sum(w * f(x + k * h) for k, w in zip(range(-2, 3), weights[0], strict=True)) / h ** weights[1]


@pytest.mark.parametrize(
    "field", [Rock((0.1, 0.2, 0.3), (1.0, 2.0, -1.0)), Twist((0.1, 0.2, 0.3), (1.0, 2.0, -1.0))]
)
def test_rocking_is_rigid_and_leaves_the_axis_alone(field):
    np.testing.assert_allclose(stretch(field, points()), 0.0, atol=1e-14)
    axis = np.array([1.0, 2.0, -1.0]) / np.sqrt(6)
    on_axis = np.array([0.1, 0.2, 0.3]) + np.outer([-2.0, 0.0, 0.7], axis)
    np.testing.assert_allclose(field(on_axis), 0.0, atol=1e-15)
    # Right-handed and by one radian: a point one unit off the axis moves by one.
    off = np.array([[0.1, 0.2, 0.3]]) + np.array([2.0, -1.0, 0.0]) / np.sqrt(5)
    np.testing.assert_allclose(field(off), np.cross(axis, off - [0.1, 0.2, 0.3]), atol=1e-15)
    assert np.linalg.norm(field(off)) == pytest.approx(1.0)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_a_beam_is_exactly_still_behind_its_clamp_and_moves_by_one_at_its_tip(order):
    field = beam(order)
    behind = points(4000) - BASE
    behind = BASE + behind[behind @ AXIS <= 0]
    assert len(behind) > 500
    np.testing.assert_array_equal(field(behind), 0.0)
    assert np.linalg.norm(field(TIP[None])) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_a_beam_obeys_euler_and_bernoulli(order):
    # EI w'''' = ω² m w: the fourth derivative is (β/L)⁴ w all along the beam; w = w' = 0 at the clamp and
    # w'' = w''' = 0 at the free end.
    field = beam(order)
    height = np.linspace(0.06, LENGTH - 0.06, 40)

    def deflection(h):
        return field.profile(h)[0]

    stiff = (BETAS[order - 1] / LENGTH) ** 4
    fourth = derivative(deflection, height, 0.004, 4)
    np.testing.assert_allclose(fourth, stiff * deflection(height), rtol=0, atol=2e-3 * stiff)
    numeric = (deflection(height + 1e-6) - deflection(height - 1e-6)) / 2e-6
    np.testing.assert_allclose(field.profile(height)[1], numeric, rtol=0, atol=1e-6 * stiff**0.25)
    assert field.profile(np.array([0.0, -1.0]))[1].tolist() == [0.0, 0.0]
    near = LENGTH - np.array([0.01, 0.02])
    bend = derivative(deflection, near, 0.002)
    np.testing.assert_allclose(bend, 0.0, atol=0.05 * stiff**0.5)  # falls as the square of the way to the end


def test_what_stands_on_a_beam_turns_rigidly_and_sections_stay_plane():
    field = beam()
    beyond = BASE + points() - np.outer((points()) @ AXIS, AXIS)  # in the plane of the clamp
    high = beyond + np.outer(LENGTH * (1.0 + np.random.default_rng(3).random(200)), AXIS)
    np.testing.assert_allclose(stretch(field, high), 0.0, atol=1e-12)
    section = beyond + 0.4 * LENGTH * AXIS
    np.testing.assert_allclose(stretch(field, section), 0.0, atol=1e-12)


@pytest.mark.parametrize("nodes", [(0, 1), (1, 1), (2, 2), (0, 3)])
def test_a_membrane_solves_the_wave_equation_and_is_zero_from_its_rim_on(nodes):
    centre, radius = np.array([0.3, 0.1, -0.2]), 0.7
    field = Membrane(tuple(centre), (0.0, 0.0, 2.0), radius, nodes)
    rng = np.random.default_rng(0)
    r, theta = radius * rng.uniform(0.1, 0.95, 300), rng.uniform(0, 2 * np.pi, 300)
    where = centre + np.stack([r * np.cos(theta), r * np.sin(theta), 0 * r], 1)

    def height(shift):
        return field(where + shift)[:, 2]

    laplacian = sum(derivative(lambda s, e=e: height(s * e), 0.0, 2e-3) for e in np.eye(3)[:2])
    number = (bessel_zero(*nodes) / radius) ** 2
    np.testing.assert_allclose(laplacian, -number * height(0.0), rtol=0, atol=1e-5 * number)
    outside = centre + np.stack([np.cos(theta), np.sin(theta), r], 1) * (radius * (1 + 1e-12))
    np.testing.assert_array_equal(field(outside), 0.0)
    inside = centre + radius * (1 - 1e-7) * np.stack([np.cos(theta), np.sin(theta), 0 * r], 1)
    assert np.abs(field(inside)).max() < 1e-5
    np.testing.assert_array_equal(field(where)[:, :2], 0.0)


@pytest.mark.parametrize("nodes", [(1, 1), (2, 1), (3, 2)])
def test_a_plate_solves_its_equation_and_is_zero_at_and_outside_its_edges(nodes):
    a, b = 0.8, 0.5
    field = Plate((0.1, 0.2, 0.3), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (a, b), nodes)
    centre = np.array([0.1, 0.2, 0.3])
    rng = np.random.default_rng(0)
    u, v = rng.uniform(-0.45, 0.45, (2, 200))
    where = centre + np.stack([b * v, 0 * u, a * u], 1)

    def height(shift):
        return field(where + shift)[:, 1]

    def laplacian(shift):
        return sum(derivative(lambda s, e=e: height(shift + s * e), 0.0, 2e-3) for e in np.eye(3)[[0, 2]])

    number = (nodes[0] * np.pi / a) ** 2 + (nodes[1] * np.pi / b) ** 2
    # Simply supported: ∇²w = −k w with w = 0 at the edges, so ∇⁴w = k² w too.
    np.testing.assert_allclose(laplacian(0.0), -number * height(0.0), rtol=0, atol=1e-5 * number)
    assert np.abs(height(0.0)).max() > 0.9
    edges = centre + np.array([[0, 0, 0.5 * a], [0.5 * b, 0, 0], [0, 0, -0.41], [-0.3, 0, 0], [3, 0, 3]])
    np.testing.assert_allclose(field(edges[:2]), 0.0, atol=1e-15)
    np.testing.assert_array_equal(field(edges[2:]), 0.0)


@pytest.mark.parametrize(
    "field",
    [
        Membrane((0, 0, 0), (0, 0, 1), 1.0, thickness=0.1),
        Plate((0, 0, 0), (0, 0, 1), (1, 0, 0), (1.0, 1.0), thickness=0.1),
    ],
)
def test_thickness_ends_the_reach_along_the_normal_smoothly(field):
    z = np.array([0.0, 0.05, -0.05, 0.075, 0.1, -0.1, 0.5])
    height = field(np.stack([0 * z, 0 * z, z], 1))[:, 2]
    np.testing.assert_allclose(height, [1.0, 1.0, 1.0, 0.5, 0.0, 0.0, 0.0], atol=1e-14)
    np.testing.assert_array_equal(height[4:], 0.0)


def test_a_wave_travels_along_its_direction_at_frequency_times_wavelength():
    field = Wave((3.0, 4.0, 0.0), 0.5, (0.0, 0.0, 1.0))
    where, frequency, seconds = points(), 5.0, 0.013
    turn = np.exp(2j * np.pi * frequency * seconds)
    behind = where - frequency * 0.5 * seconds * np.array([0.6, 0.8, 0.0])
    # What a point does now, the point behind it did before.
    np.testing.assert_allclose((field(where) * turn).real, field(behind).real, atol=1e-12)
    assert np.abs((field(where) * turn).real - field(2 * where - behind).real).max() > 0.5
    np.testing.assert_allclose(reach(field(where)), 1.0)


def test_a_wave_dies_out_from_its_level_and_outside_its_region():
    where = points()
    plain = Wave((1, 0, 0), 0.5, (0, 0, 1))(where)
    damped = Wave((1, 0, 0), 0.5, (0, 0, 1), decay_length=0.2, level=0.1)(where)
    np.testing.assert_allclose(damped, plain * np.exp(-np.abs(where[:, 2:] - 0.1) / 0.2), atol=1e-14)
    local = Wave((1, 0, 0), 0.5, (0, 0, 1), region=BallRegion((0.1, 0.0, 0.0), 0.8))(where)
    distance = np.linalg.norm(where - [0.1, 0, 0], axis=1)
    np.testing.assert_array_equal(local[distance >= 0.8], 0.0)
    np.testing.assert_array_equal(local[distance <= 0.4], plain[distance <= 0.4])
    ring = (distance > 0.4) & (distance < 0.8)
    assert (np.abs(local[ring]) < np.abs(plain[ring])).any(1).all()


def test_a_rayleigh_wave_turns_backwards_at_the_surface_with_the_ratio_of_the_books():
    field = Wave((1.0, 0.0, 0.0), 0.5, "rayleigh", level=0.3)
    orbit = field(np.array([[0.0, 0.0, 0.3]]))[0]
    assert abs(orbit[0]) / abs(orbit[2]) == pytest.approx(0.6813, abs=1e-4)  # Poisson's ratio 1/4
    at_top = (1j * orbit).real  # velocity when the point is highest: orbit[2] is real and positive
    assert orbit[2].real > 0
    assert at_top[0] < 0
    # What stands on the surface moves as the surface below it; two wavelengths down little is left.
    np.testing.assert_array_equal(field(np.array([[0.0, 0.0, 2.0]]))[0], orbit)
    assert np.abs(field(np.array([[0.0, 0.0, -0.7]]))).max() < 0.02 * np.abs(orbit).max()


def test_a_rayleigh_wave_leaves_the_surface_free_of_traction():
    field = Wave((1.0, 0.0, 0.0), 0.5, "rayleigh", level=0.0)
    h = 1e-4

    def at(x, z):
        return field(np.array([[x, 0.0, z]]))[0]

    down = (-3 * at(0, 0) + 4 * at(0, -h) - at(0, -2 * h)) / (-2 * h)  # ∂/∂z from below
    along = (at(h, 0) - at(-h, 0)) / (2 * h)
    scale = np.abs(np.concatenate([down, along])).max()
    # λ = μ for Poisson's ratio 1/4.
    assert abs(down[0] + along[2]) < 1e-5 * scale
    assert abs(along[0] + 3 * down[2]) < 1e-5 * scale


def test_phases_at_quarter_turns_are_exact():
    turns = np.array([0, 90, 180, 270, 360, -90, 720])
    np.testing.assert_array_equal(phasor(turns), [1, 1j, -1, -1j, 1, -1j, 1])
    angles = np.random.default_rng(0).uniform(-1000, 1000, 100)
    np.testing.assert_allclose(phasor(angles), np.exp(1j * np.radians(angles)), atol=1e-13)
