"""The animator for looking gives the poses of the exact one, from few fields where frequencies share them."""

import numpy as np
import pytest
import torch

from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.animate import animate, animator
from tg4mm.fit.motion.modes import ModalMotion

N, K, R = 300, 24, 3


@pytest.fixture
def moved():
    """Gaussians whose 24 frequencies are mixtures of three fields; rotations are 100 times the displacements."""
    rng = np.random.default_rng(0)
    fields = rng.normal(size=(R, N, 6)) * np.repeat([1e-3, 1e-1], 3)
    mixed = np.einsum("kr,rnc->knc", rng.normal(size=(K, R)) + 1j * rng.normal(size=(K, R)), fields)
    tensors = [
        torch.tensor(rng.normal(size=s), dtype=torch.float32)
        for s in ((N, 3), (N, 4), (N, 3), (N,), (N, 1, 3))
    ]
    phasors = mixed.astype(np.complex64)
    motion = ModalMotion(np.linspace(0.5, 14, K), phasors[..., :3], phasors[..., 3:], 30.0, 60)
    return Gaussians(*tensors), motion


@pytest.mark.parametrize(("alpha", "band"), [(0.0, None), (30.0, (2.0, 6.0)), (-1.0, None)])
def test_poses_are_those_of_animate(moved, alpha, band):
    gaussians, motion = moved
    pose = animator(gaussians, motion, packed=True)
    for t in (0.0, 7.3):
        exact, packed = animate(gaussians, motion, t, alpha, band), pose(t, alpha, band)
        size = float((exact.means - gaussians.means).abs().max()) + 1e-3
        assert float((packed.means - exact.means).abs().max()) < 1e-4 * size
        assert float((packed.quats - exact.quats).abs().max()) < 1e-4


def test_shared_fields_are_held_once(moved):
    pose = animator(*moved, packed=True)
    fields, series = pose.args[2:4]
    assert fields.shape == (R, 6 * N)
    assert series.shape == (K, R)
