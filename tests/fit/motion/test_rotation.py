"""How Gaussians turn with what they are made of: whole if rigid, balls by the curl, flakes and needles as they lie."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tg4mm.fit.motion.prior.rotation import gradient_to_rotation

OMEGA = np.array([0.02, -0.03, 0.05])
SHAPES = {"ball": (1, 1, 1), "flake": (1, 1, 0.02), "needle": (0.02, 1, 0.02), "any": (1, 0.6, 0.3)}


def rotation_of(gradient, axes, scales):
    """[3] for a gradient [along, of]."""
    return gradient.reshape(9) @ gradient_to_rotation(axes[None], np.array([scales], float))[0]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_rigid_turn_is_followed_whole(shape, seed):
    axes = Rotation.random(random_state=seed).as_matrix()
    np.testing.assert_allclose(rotation_of(np.cross(OMEGA, np.eye(3)), axes, SHAPES[shape]), OMEGA, atol=1e-7)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_needle_and_a_flake_stay_on_their_material(seed):
    """Any gradient: the needle's direction d moves by G d across itself, the flake's normal n by −Gᵀ n."""
    rng = np.random.default_rng(seed)
    axes = Rotation.random(random_state=seed).as_matrix()
    gradient = 0.01 * rng.normal(size=(3, 3))  # [along, of]: G = gradientᵀ
    d = axes[:, 1]
    across = gradient.T @ d - d * (d @ gradient.T @ d)
    np.testing.assert_allclose(
        np.cross(rotation_of(gradient, axes, SHAPES["needle"]), d), across, atol=0.02 * np.abs(gradient).max()
    )
    n = axes[:, 2]
    tilt = -(gradient @ n) + n * (n @ gradient @ n)
    np.testing.assert_allclose(
        np.cross(rotation_of(gradient, axes, SHAPES["flake"]), n), tilt, atol=0.02 * np.abs(gradient).max()
    )


@pytest.mark.parametrize("shape", SHAPES)
def test_the_covariance_changes_as_nearly_as_a_turn_can(shape):
    """Against other rotations: none is nearer to GΣ + ΣGᵀ by more than the little that is drawn to half the curl."""
    scales = SHAPES[shape]
    rng, axes = np.random.default_rng(4), Rotation.random(random_state=4).as_matrix()
    gradient = rng.normal(size=(3, 3))
    covariance = axes @ np.diag(np.square(scales, dtype=float)) @ axes.T

    def left(omega):
        spin = np.cross(omega, np.eye(3)).T
        change = (gradient.T - spin) @ covariance
        return float(((change + change.T) ** 2).sum())

    found = rotation_of(gradient, axes, scales)
    nearest = min(left(found + 0.2 * rng.normal(size=3)) for _ in range(200))
    assert left(found) < nearest + 0.03 * left(np.zeros(3))
    curl = np.array([gradient[i, j] - gradient[j, i] for i, j in ((1, 2), (2, 0), (0, 1))])
    if shape == "ball":
        np.testing.assert_allclose(found, curl / 2, atol=1e-5)
    else:
        assert np.linalg.norm(found - curl / 2) > 0.1 * np.linalg.norm(curl)
