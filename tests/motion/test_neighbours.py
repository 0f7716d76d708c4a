"""Rigid neighbourhoods: what costs nothing, what does, and the rotation that displacements imply."""

from __future__ import annotations

import numpy as np
import pytest

from tg4mm.motion.neighbours import Neighbourhoods, neighbourhoods

OMEGA, SHIFT = np.array([0.02, -0.03, 0.05]), np.array([0.1, 0.2, -0.3])


def volume(n: int = 300) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1, 1, (n, 3))


def plane(n: int = 300) -> np.ndarray:
    """Tilted, without thickness."""
    uv = np.random.default_rng(1).uniform(-1, 1, (n, 2))
    return uv @ np.array([[1, 0, 0.5], [0, 1, -0.3]])


def wire(n: int = 60) -> np.ndarray:
    """Straight, along (1, 2, 2) / 3."""
    return np.linspace(-1, 1, n)[:, None] * np.array([1, 2, 2]) / 3


def strand(n: int = 60) -> np.ndarray:
    """A wire with a thickness at which its twist is just fading: least squares and what is done part ways."""
    return wire(n) + 0.02 * np.random.default_rng(7).normal(size=(n, 3))


def rigid(means: np.ndarray) -> np.ndarray:
    return SHIFT + np.cross(OMEGA, means)


def energy(around: Neighbourhoods, u: np.ndarray) -> float:
    return float((u * around.stiffness(u.astype(np.float32))).sum())


@pytest.mark.parametrize("shape", [volume, plane])
def test_a_rigid_motion_is_found_and_costs_nothing(shape) -> None:
    means = shape()
    around = neighbourhoods(means)
    u = rigid(means).astype(np.float32)
    error = np.linalg.norm(around.rotations(u) - OMEGA, axis=1) / np.linalg.norm(OMEGA)
    assert np.median(error) < 1e-4
    assert error.max() < 5e-3  # at a corner, where the neighbours are nearly in line
    shuffled = np.random.default_rng(0).permutation(np.cross(OMEGA, means))
    assert 0 <= energy(around, u) < 1e-5 * energy(around, shuffled)


def test_a_shift_turns_nothing() -> None:
    around = neighbourhoods(volume())
    u = np.tile(SHIFT, (300, 1)).astype(np.float32)
    assert np.abs(around.rotations(u)).max() < 1e-5
    assert abs(energy(around, u)) < 1e-6


def test_a_straight_wire_bends_but_has_no_twist() -> None:
    """Its rotation is what the displacements show: ω less its part along the wire."""
    means, axis = wire(), np.array([1, 2, 2]) / 3
    around = neighbourhoods(means)
    u = rigid(means).astype(np.float32)
    expected = OMEGA - axis * (axis @ OMEGA)
    assert np.linalg.norm(OMEGA - expected) > 0.01
    np.testing.assert_allclose(around.rotations(u), np.tile(expected, (60, 1)), atol=1e-4)
    # a curved deflection s² n: the middle of the neighbourhood turns by 2 s about axis × n
    n = np.array([2, -2, 1]) / 3
    s = np.linspace(-1, 1, 60)
    turned = around.rotations((0.01 * s[:, None] ** 2 * n).astype(np.float32))
    slope = turned @ np.cross(axis, n)
    np.testing.assert_allclose(slope[10:-10], 0.02 * s[10:-10], atol=2e-4)
    assert np.abs(turned @ axis).max() < 1e-6


def test_shaking_on_a_nearly_straight_wire_makes_no_twist() -> None:
    """A thousandth of its length thick: dividing by its twist inertia would make radians of noise."""
    rng = np.random.default_rng(0)
    means = wire() + 1e-4 * rng.normal(size=(60, 3))
    turned = neighbourhoods(means).rotations((1e-4 * rng.normal(size=(60, 3))).astype(np.float32))
    assert np.abs(turned @ (np.array([1, 2, 2]) / 3)).max() < 1e-2


@pytest.mark.parametrize("deformation", ["stretch", "shear", "bend"])
def test_what_deforms_costs(deformation: str) -> None:
    means = volume()
    x, zero = means[:, 0], np.zeros(len(means))
    field = {"stretch": [x, zero, zero], "shear": [zero, x, zero], "bend": [zero, zero, x**2]}[deformation]
    around = neighbourhoods(means)
    u = np.stack(field, 1)
    assert energy(around, u) > 1e-3 * energy(around, np.random.default_rng(0).permutation(u))


@pytest.mark.parametrize("shape", [volume, plane, wire, strand])
def test_stiffness_is_symmetric_and_not_negative(shape) -> None:
    means = shape()
    around, rng = neighbourhoods(means), np.random.default_rng(2)
    for _ in range(5):
        u, v = rng.normal(size=(2, *means.shape)).astype(np.float32)
        uv, vu = (u * around.stiffness(v)).sum(dtype=float), (v * around.stiffness(u)).sum(dtype=float)
        scale = np.sqrt(energy(around, u) * energy(around, v))
        assert abs(uv - vu) < 1e-4 * scale
        assert energy(around, u) > 0


@pytest.mark.parametrize("shape", [volume, plane, wire, strand])
def test_its_energy_is_what_the_rotation_leaves(shape) -> None:
    """Σ w |u_j − u_i − ω_i × (x_j − x_i)|² with the ω_i of `rotations`, summed by hand, up to one factor."""
    means = shape(40)
    around, rng = neighbourhoods(means, count=6), np.random.default_rng(3)
    noise = rng.normal(size=(3, 40, 3))
    fields = [*noise, noise[0] + 5 * means, np.cross(OMEGA, means) * means[:, :1]]
    ratios = [
        brute_energy(means, u, around.rotations(u.astype(np.float32)), 6) / energy(around, u) for u in fields
    ]
    np.testing.assert_allclose(ratios, ratios[0], rtol=1e-3)


def test_on_a_volume_the_rotation_is_that_of_least_squares() -> None:
    means = volume(40)
    around, u = (
        neighbourhoods(means, count=12),
        np.random.default_rng(3).normal(size=(40, 3)).astype(np.float32),
    )
    found = around.rotations(u)
    best = brute_energy(means, u, found, 12)
    for seed in range(5):
        other = found + 0.05 * np.random.default_rng(seed).normal(size=found.shape)
        assert brute_energy(means, u, other, 12) > best


def brute_energy(means: np.ndarray, u: np.ndarray, omega: np.ndarray, count: int) -> float:
    total = 0.0
    for i in range(len(means)):
        distance = np.linalg.norm(means - means[i], axis=1)
        near = np.argsort(distance)[1 : count + 1]
        w = np.exp(-0.5 * (distance[near] / distance[near].mean()) ** 2)
        left = u[near] - u[i] - np.cross(omega[i], means[near] - means[i])
        total += float((w[:, None] * left**2).sum())
    return total


def test_its_mean_diagonal_is_one() -> None:
    """Measured with other random signs than the code's."""
    means = volume()
    around = neighbourhoods(means)
    rng, total = np.random.default_rng(99), []
    for _ in range(20):
        signs = rng.choice([-1.0, 1.0], means.shape)
        total.append(energy(around, signs) / signs.size)
    assert np.mean(total) == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize("shape", [volume, plane, wire])
def test_from_rotations_is_the_transpose(shape) -> None:
    means = shape()
    around, rng = neighbourhoods(means), np.random.default_rng(4)
    u, v = rng.normal(size=(2, *means.shape)).astype(np.float32)
    one = (around.rotations(u).astype(float) * v).sum()
    other = (around.from_rotations(v).astype(float) * u).sum()
    scale = np.linalg.norm(around.rotations(u)) * np.linalg.norm(v)
    assert abs(one - other) < 1e-6 * scale
    assert abs(one) > 1e-4 * scale


def test_rotation_does_not_depend_on_the_unit_of_length() -> None:
    small, large = neighbourhoods(volume()), neighbourhoods(1e3 * volume())
    u = np.random.default_rng(5).normal(size=(300, 3)).astype(np.float32)
    np.testing.assert_allclose(small.rotations(u), large.rotations(1e3 * u), rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(small.stiffness(u), large.stiffness(u), rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("n", [4, 13])
def test_fewer_gaussians_than_neighbours_are_all_neighbours(n: int) -> None:
    means = volume(n)
    turned = neighbourhoods(means).rotations(rigid(means).astype(np.float32))
    np.testing.assert_allclose(turned, np.tile(OMEGA, (n, 1)), atol=2e-3)


def test_doubled_points_are_no_trouble() -> None:
    means = np.repeat(volume(30), 15, axis=0)
    around = neighbourhoods(means)
    u = np.random.default_rng(6).normal(size=means.shape).astype(np.float32)
    assert np.isfinite(around.stiffness(u)).all()
    assert np.abs(around.rotations(u)).max() < 1e-3
