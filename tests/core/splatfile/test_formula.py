"""x(t, α): α = 0 is the motion as captured, a sinusoid grows by 1 + α, out of band nothing changes."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.core.splatfile.conftest import random_splat
from tests.helpers.dense import sh_colours
from tg4mm.core.errors import SplatFileError
from tg4mm.core.splatfile import positions_at, rotations_at
from tg4mm.core.splatfile.formula import TURN, harmonics_turn, transformed
from tg4mm.fit.gaussians import rotation_matrices

times = st.floats(-100, 100)
alphas = st.floats(-2, 100)
seeds = st.integers(0, 2**32 - 1)


def one_mode(freq=3.0, displacement=(0, 0, 0), rotation=(0, 0, 0)):
    """One Gaussian, not turned, with one mode."""
    return replace(
        random_splat(n=1, m=1),
        freqs_hz=np.array([freq]),
        displacement=np.array([[displacement]], np.complex64),
        rotation=np.array([[rotation]], np.complex64),
        quats=np.array([[1, 0, 0, 0]], np.float32),
    )


def rotated(quats, v):
    """v [3] turned by unit quaternions wxyz [N, 4]: v + 2 u × (u × v + w v)."""
    w, u = quats[:, :1], quats[:, 1:]
    return v + 2 * np.cross(u, np.cross(u, v) + w * v)


@given(times, alphas)
def test_a_sinusoid_in_metres_of_motion(t, alpha):
    """Phasor −i·a is a·sin(2π f t / fps), phasor a is a·cos: the sign convention."""
    splat = one_mode(3.0, displacement=(-0.5j, 0.25, 0))
    w = 2 * math.pi * 3.0 * t / 30
    moved = positions_at(splat, t, alpha) - splat.means
    expected = (1 + alpha) * np.array([[0.5 * math.sin(w), 0.25 * math.cos(w), 0]])
    np.testing.assert_allclose(moved, expected, atol=1e-5)


@given(seeds, times, alphas, st.floats(0, 7), st.floats(7, 15))
def test_modes_outside_the_band_keep_their_size(seed, t, alpha, low, high):
    assume(low < high)
    splat = random_splat(seed, m=4)
    inside = (splat.freqs_hz >= low) & (splat.freqs_hz <= high)

    def only(mask):
        part = replace(splat, displacement=splat.displacement * mask[:, None, None].astype(np.float32))
        return positions_at(part, t) - splat.means

    expected = (1 + alpha) * only(inside) + only(~inside)
    np.testing.assert_allclose(positions_at(splat, t, alpha, (low, high)) - splat.means, expected, atol=1e-9)


def test_both_ends_of_the_band_are_inside():
    splat = one_mode(3.0, displacement=(1, 0, 0))
    x = [
        positions_at(splat, 0, 1.0, band)[0, 0] - splat.means[0, 0]
        for band in ((3, 4), (2, 3), (3.1, 4), (1, 2.9))
    ]
    np.testing.assert_allclose(x, [2, 2, 1, 1], atol=1e-6)


@given(times, alphas, st.tuples(*[st.floats(-1, 1)] * 3))
def test_a_rotation_phasor_turns_about_its_axis_by_the_magnified_angle(t, alpha, axis):
    size = math.hypot(*axis)
    assume(size > 1e-3)
    splat = one_mode(3.0, rotation=[0.02 * a for a in axis])
    quats = rotations_at(splat, t, alpha)
    angle = (1 + alpha) * 0.02 * size * math.cos(2 * math.pi * 3 * t / 30)
    np.testing.assert_allclose(np.linalg.norm(quats, axis=1), 1, atol=1e-12)
    k, v = np.array(axis) / size, np.array([0.3, -0.7, 0.5])
    # Rodrigues' formula
    expected = v * math.cos(angle) + np.cross(k, v) * math.sin(angle) + k * (k @ v) * (1 - math.cos(angle))
    np.testing.assert_allclose(rotated(quats, v)[0], expected, atol=1e-5)


@given(seeds, times)
def test_the_turn_follows_the_rest_rotation_in_world_axes(seed, t):
    splat = random_splat(seed)
    untwisted = replace(splat, quats=np.tile(np.array([1, 0, 0, 0], np.float32), (5, 1)))
    still = replace(splat, rotation=splat.rotation * np.float32(0))
    v = np.array([0.3, -0.7, 0.5])
    at_rest = rotated(rotations_at(still, t), v)
    turn = rotations_at(untwisted, t)
    expected = np.stack([rotated(turn[i : i + 1], at_rest[i])[0] for i in range(5)])
    np.testing.assert_allclose(rotated(rotations_at(splat, t), v), expected, atol=1e-9)


@pytest.mark.parametrize("band", [(4, 4), (5, 4), (-1, 4), (math.nan, 4), (1, math.inf)])
def test_a_bad_band_is_refused(band):
    with pytest.raises(SplatFileError, match=r"band \(.*\) Hz; expected 0 ≤ low < high"):
        positions_at(random_splat(), 0, 1.0, band)


@pytest.mark.parametrize("k", [1, 4, 9, 16])
def test_a_colour_is_seen_from_the_turned_direction(k):
    rng = np.random.default_rng(1)
    sh, directions = rng.normal(size=(40, k, 3)), rng.normal(size=(40, 3))
    other = np.einsum("jk,nkc->njc", harmonics_turn(TURN, k), sh)
    before, after = (
        sh_colours(torch.as_tensor(one), torch.as_tensor(seen))
        for one, seen in ((sh, directions), (other, directions @ TURN.T))
    )
    np.testing.assert_allclose(after, before, atol=1e-12)
    assert (before > 0).any()
    if k > 1:
        assert (
            np.abs(sh_colours(torch.as_tensor(sh), torch.as_tensor(directions @ TURN.T)) - before).max() > 0.1
        )


def covariances(splat, t=0.0, alpha=0.0):
    axes = (
        rotation_matrices(torch.as_tensor(rotations_at(splat, t, alpha))).numpy() * splat.scales[:, None, :]
    )
    return axes @ axes.transpose(0, 2, 1)


def similarity(seed, mirrored):
    u, _, v = np.linalg.svd(np.random.default_rng(seed).normal(size=(3, 3)))
    turn = u @ v
    return 2.5 * turn * np.sign(np.linalg.det(turn)) * (-1 if mirrored else 1)


@pytest.mark.parametrize("mirrored", [False, True])
def test_what_turns_and_scales_alike_commutes_with_the_motion(mirrored):
    splat, linear, shift = (
        random_splat(seed=1, n=40, deviation=True),
        similarity(5, mirrored),
        [1.0, -2.0, 3.0],
    )
    other = transformed(splat, linear, shift)
    np.testing.assert_allclose(
        positions_at(other, 3.5, 7.0), positions_at(splat, 3.5, 7.0) @ linear.T + shift, rtol=1e-5, atol=1e-4
    )
    np.testing.assert_allclose(
        covariances(other, 3.5, 7.0), linear @ covariances(splat, 3.5, 7.0) @ linear.T, rtol=1e-3, atol=1e-6
    )
    np.testing.assert_allclose(other.deviation, 2.5 * splat.deviation, rtol=1e-5)
    assert other.unit_scale_m == pytest.approx(splat.unit_scale_m / 2.5)
    rng = np.random.default_rng(2)
    directions = rng.normal(size=(40, 3))
    before, after = (
        sh_colours(torch.as_tensor(one.sh.astype(np.float64)), torch.as_tensor(seen))
        for one, seen in ((splat, directions), (other, directions @ (linear.T / 2.5)))
    )
    np.testing.assert_allclose(after, before, atol=1e-5)


def test_a_stretched_scene_has_stretched_gaussians_and_no_metres():
    splat = random_splat(seed=2, n=40)
    linear = similarity(6, True) @ np.diag([1.0, 0.2, 3.0])
    other = transformed(splat, linear)
    np.testing.assert_allclose(
        covariances(other, alpha=-1.0),
        linear @ covariances(splat, alpha=-1.0) @ linear.T,
        rtol=1e-3,
        atol=1e-6,
    )
    np.testing.assert_allclose(
        positions_at(other, 2.0, 9.0), positions_at(splat, 2.0, 9.0) @ linear.T, rtol=1e-4, atol=1e-4
    )
    assert other.unit_scale_m is None
