"""Motion magnified: exact factors and bands, true rotations; the viewer's animator gives the same poses."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from tests.helpers.motion_animate import FPS, N, alphas, gaussians, motion
from tg4mm.core.splatfile import SplatFile, positions_at, rotations_at
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.animate import animate, animator, fields_on, rotated
from tg4mm.fit.motion.modes import ModalMotion

TIMES = (0, 1, 7, 12.5)
MIXED, K, R = 300, 24, 3


def one(m, k):
    return replace(m, freqs_hz=m.freqs_hz[[k]], displacement=m.displacement[[k]], rotation=m.rotation[[k]])


class TestRotated:
    @pytest.mark.parametrize("size", [1e-9, 1e-3, 1.0, 3.0, 10.0])
    def test_it_is_scipys_rotation(self, size):
        """Applied from the left: about the world's axes, not the Gaussian's own."""
        q = gaussians(torch.float64).quats
        r = size * np.random.default_rng(2).normal(size=(N, 3))
        expected = Rotation.from_rotvec(r) * Rotation.from_quat(q.numpy()[:, [1, 2, 3, 0]])
        found = rotated(q, torch.from_numpy(r)).numpy()
        apart = (expected * Rotation.from_quat(found[:, [1, 2, 3, 0]]).inv()).magnitude()
        assert apart.max() < 1e-7
        np.testing.assert_allclose(
            np.linalg.norm(found, axis=1), torch.linalg.vector_norm(q, dim=1), rtol=1e-12
        )

    def test_no_rotation_changes_nothing_and_has_a_gradient(self):
        q, r = gaussians(torch.float64).quats, torch.zeros(N, 3, dtype=torch.float64, requires_grad=True)
        turned = rotated(q, r)
        assert torch.equal(turned.detach(), q)
        turned.sum().backward()
        assert r.grad is not None
        assert torch.isfinite(r.grad).all()


class TestMoved:
    @pytest.mark.parametrize("band", [None, (4.0, 6.0)])
    @pytest.mark.parametrize("t", TIMES)
    def test_it_agrees_with_the_splat_file(self, t, band):
        g, m = gaussians(), motion()
        arrays = [a.numpy() for a in (g.means, g.quats, g.scales, g.opacities, g.sh)]
        splat = SplatFile(*arrays, m.freqs_hz, m.displacement, m.rotation, FPS, 30)
        found = animate(g, m, t, alphas(m, 4.0, band))
        np.testing.assert_allclose(found.means, positions_at(splat, t, 4.0, band), atol=3e-6)
        quats = torch.nn.functional.normalize(found.quats, dim=1).numpy()
        np.testing.assert_allclose(quats, rotations_at(splat, t, 4.0, band), atol=3e-6)

    def test_a_rigid_motion_of_the_whole_scene_commutes_with_magnification(self):
        turn, shift = Rotation.from_rotvec([0.5, -1.0, 0.3]), np.array([1.0, 2.0, -3.0])

        def placed(g):
            quats = turn * Rotation.from_quat(g.quats.numpy()[:, [1, 2, 3, 0]])
            means = turn.apply(g.means.numpy()) + shift
            return replace(
                g, means=torch.from_numpy(means), quats=torch.from_numpy(quats.as_quat()[:, [3, 0, 1, 2]])
            )

        def turned(phasors):
            return phasors @ turn.as_matrix().T

        g, m = gaussians(torch.float64), motion()
        alpha = alphas(m, 20.0, (4, 6))
        other = replace(m, displacement=turned(m.displacement), rotation=turned(m.rotation))
        one, two = placed(animate(g, m, 7, alpha)), animate(placed(g), other, 7, alpha)
        np.testing.assert_allclose(one.means, two.means, atol=1e-5)
        same = Rotation.from_quat(one.quats.numpy()[:, [1, 2, 3, 0]])
        assert (same * Rotation.from_quat(two.quats.numpy()[:, [1, 2, 3, 0]]).inv()).magnitude().max() < 1e-5

    def test_a_motion_of_other_gaussians_is_refused(self):
        m = motion()
        m = replace(m, displacement=m.displacement[:, :-1], rotation=m.rotation[:, :-1])
        with pytest.raises(ValueError, match="the motion has 19 Gaussians, the scene 20"):
            animate(gaussians(), m, 0)


@pytest.fixture
def moved():
    """Gaussians whose 24 frequencies are mixtures of three fields; rotations are 100 times the displacements."""
    rng = np.random.default_rng(0)
    fields = rng.normal(size=(R, MIXED, 6)) * np.repeat([1e-3, 1e-1], 3)
    mixed = np.einsum("kr,rnc->knc", rng.normal(size=(K, R)) + 1j * rng.normal(size=(K, R)), fields)
    tensors = [
        torch.tensor(rng.normal(size=s), dtype=torch.float32)
        for s in ((MIXED, 3), (MIXED, 4), (MIXED, 3), (MIXED,), (MIXED, 1, 3))
    ]
    phasors = mixed.astype(np.complex64)
    motion = ModalMotion(np.linspace(0.5, 14, K), phasors[..., :3], phasors[..., 3:], 30.0, 60)
    return Gaussians(*tensors), motion


@pytest.mark.parametrize(("alpha", "band"), [(0.0, None), (30.0, (2.0, 6.0)), (-1.0, None)])
def test_poses_are_those_of_animate(moved, alpha, band):
    gaussians, motion = moved
    pose = animator(gaussians, motion)
    own = alphas(motion, alpha, band)
    for t in (0.0, 7.3):
        exact, packed = animate(gaussians, motion, t, own), pose(t, own)
        size = float((exact.means - gaussians.means).abs().max()) + 1e-3
        assert float((packed.means - exact.means).abs().max()) < 1e-4 * size
        assert float((packed.quats - exact.quats).abs().max()) < 1e-4


def test_shared_fields_are_held_once(moved):
    fields, series = fields_on(torch.device("cpu"), moved[1])
    assert fields.shape == (R, 6 * MIXED)
    assert series.shape == (K, R)
