"""Motions that pictures leave open: most of the scene still, or in the picture's plane."""

import numpy as np

from tg4mm.fit.motion.nuisance.projection import with_still_background
from tg4mm.fit.motion.pipeline import in_plane

RNG = np.random.default_rng(0)
MEANS = RNG.normal(size=(400, 3))


def moving() -> np.ndarray:
    """[2, N, 6]: a tenth of the Gaussians moves, each its own way, the others stand still."""
    fields = np.zeros((2, 400, 6), np.float32)
    fields[:, :40] = RNG.normal(size=(2, 40, 6))
    return fields


def rigid() -> np.ndarray:
    """[2, N, 6]: a rigid motion of the whole scene."""
    out = np.zeros((2, 400, 6), np.float32)
    for r in range(2):
        shift, turn = RNG.normal(size=(2, 3))
        out[r, :, :3], out[r, :, 3:] = shift + np.cross(turn, MEANS), turn
    return out


def test_a_rigid_motion_of_the_whole_scene_is_taken_off() -> None:
    own = moving()
    found = with_still_background(own + rigid(), MEANS, np.ones(400))
    assert np.abs(found[:, 40:]).max() < 0.02
    assert np.abs(found[..., :3] - own[..., :3]).max() < 0.05
    assert np.abs(own + rigid() - own).max() > 0.5


def test_a_flat_motion_has_nothing_along_the_sight() -> None:
    normal = np.array([0.0, 0.6, 0.8])
    fields = RNG.normal(size=(3, 50, 6))
    found = in_plane(fields, normal)
    assert np.abs(found[..., :3] @ normal).max() < 1e-12
    across = np.cross(normal, [1.0, 0, 0])
    np.testing.assert_allclose(found[..., :3] @ across, fields[..., :3] @ across)
    np.testing.assert_allclose(found[..., 3:] @ normal, fields[..., 3:] @ normal)
    assert np.abs(found[..., 3:] @ across).max() < 1e-12
