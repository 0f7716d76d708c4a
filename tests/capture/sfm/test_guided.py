"""Matches along known epipolar lines, on features whose partners are known."""

from __future__ import annotations

import numpy as np
import pytest

from tests.capture.sfm.scenes import intrinsics, orbit
from tg4mm.capture.sfm.triangulate import ROWS, Features, essential, features_of, guided_matches

K = intrinsics(400, 300, 380.0)
PIXEL = 1 / 380.0


def project(viewmat: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    cam = xyz @ viewmat[:3, :3].T + viewmat[:3, 3]
    return cam[:, :2] / cam[:, 2:] * 380 + K[:2, 2]


def two_pictures(n: int, seed: int = 0) -> tuple[np.ndarray, Features, Features, np.ndarray]:
    """E, features of both pictures, and for each feature of the first its partner in the second."""
    rng = np.random.default_rng(seed)
    first, second = orbit(14)[:2]
    xyz = rng.uniform(-0.8, 0.8, (n, 3))
    descriptors = rng.random((n, 128))
    order = rng.permutation(n)
    one = features_of(project(first, xyz), descriptors, K)
    noise = rng.normal(0, 0.01, (n, 128))
    two = features_of(project(second, xyz)[order], (descriptors + noise)[order], K)
    E, _ = essential(first, second)
    return E / np.linalg.norm(E), one, two, np.argsort(order)


@pytest.mark.parametrize("n", [300, ROWS + 5])
def test_every_partner_is_found_and_no_other(n: int) -> None:
    E, one, two, partner = two_pictures(n)
    matches = guided_matches(one, two, E, PIXEL, 0.8, 0.6)
    assert matches.dtype == np.uint32
    assert len(matches) == n
    np.testing.assert_array_equal(matches[:, 1], partner[matches[:, 0]])


def test_no_features_no_matches() -> None:
    E, one, _, _ = two_pictures(4)
    none = features_of(np.zeros((0, 6)), np.zeros((0, 128), np.uint8), K)
    assert guided_matches(one, none, E, PIXEL, 0.8, 0.6).shape == (0, 2)
    assert guided_matches(none, one, E, PIXEL, 0.8, 0.6).shape == (0, 2)
