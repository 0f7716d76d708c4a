"""Turning a scene to Y up changes its axes and nothing else."""

import numpy as np
import pytest
import torch

from tests.core.splatfile.formats.conftest import turned
from tg4mm.core.splatfile import positions_at, rotations_at
from tg4mm.fit.rasterize.reference import rotation_matrices, sh_colours
from tg4mm.show.export.y_up import TURN, harmonics_turn, y_up


def test_up_becomes_y_and_handedness_stays():
    np.testing.assert_array_equal(TURN @ [0, 0, 1], [0, 1, 0])
    assert np.linalg.det(TURN) == pytest.approx(1)


def test_gaussians_and_their_motion_are_turned(splat):
    other = y_up(splat)
    np.testing.assert_allclose(
        positions_at(other, 3.5, 2.0), positions_at(splat, 3.5, 2.0) @ TURN.T, atol=1e-5
    )
    for before, after in (
        (turned(splat), turned(other)),
        (rotations_at(splat, 3.5, 2.0), rotations_at(other, 3.5, 2.0)),
    ):
        axes = rotation_matrices(torch.as_tensor(before)).numpy()
        np.testing.assert_allclose(rotation_matrices(torch.as_tensor(after)), TURN @ axes, atol=1e-5)


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
