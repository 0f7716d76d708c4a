"""A scene in other axes is the same scene: places, covariances, motion, colours."""

import numpy as np
import pytest
import torch

from tests.core.splatfile.conftest import random_splat
from tg4mm.core.splatfile import positions_at, rotations_at
from tg4mm.core.splatfile.axes import TURN, harmonics_turn, transformed
from tg4mm.fit.rasterize.reference import rotation_matrices, sh_colours


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
