"""Motion magnified: exact factors and bands, true rotations; the viewer's animator gives the same poses."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from tests.helpers.motion_animate import FPS, N, alphas, gaussians, motion
from tests.helpers.synthetic import with_phasors
from tg4mm.core.splatfile import SplatFile, positions_at, rotations_at
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.animate import animate, animator, rotated
from tg4mm.fit.motion.modes import ModalMotion, fields_of

TIMES = (0, 1, 7, 12.5)
MIXED, K, R = 300, 24, 3


def one(m, k):
    return m.selected(np.arange(len(m.freqs_hz)) == k)


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
        other = with_phasors(m, displacement=turned(m.displacement), rotation=turned(m.rotation))
        one, two = placed(animate(g, m, 7, alpha)), animate(placed(g), other, 7, alpha)
        np.testing.assert_allclose(one.means, two.means, atol=1e-5)
        same = Rotation.from_quat(one.quats.numpy()[:, [1, 2, 3, 0]])
        assert (same * Rotation.from_quat(two.quats.numpy()[:, [1, 2, 3, 0]]).inv()).magnitude().max() < 1e-5

    def test_a_motion_of_other_gaussians_is_refused(self):
        m = motion()
        m = with_phasors(m, displacement=m.displacement[:, :-1], rotation=m.rotation[:, :-1])
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
    motion = ModalMotion.of_phasors(np.linspace(0.5, 14, K), phasors[..., :3], phasors[..., 3:], 30.0, 60)
    return Gaussians(*tensors), motion, phasors


@pytest.mark.parametrize(("alpha", "band"), [(0.0, None), (30.0, (2.0, 6.0)), (-1.0, None)])
def test_poses_are_the_sums_of_the_phasors(moved, alpha, band):
    gaussians, motion, phasors = moved
    pose = animator(gaussians, motion)
    own = alphas(motion, alpha, band)
    for t in (0.0, 7.3):
        turns = (1 + own) * np.exp(2j * np.pi * motion.freqs_hz * t / motion.fps)
        change = torch.from_numpy(np.einsum("k,knc->nc", turns, phasors).real.astype(np.float32))
        found = pose(t, own)
        size = float(change[:, :3].abs().max()) + 1e-3
        assert float((found.means - gaussians.means - change[:, :3]).abs().max()) < 1e-4 * size
        assert float((found.quats - rotated(gaussians.quats, change[:, 3:])).abs().max()) < 1e-4


def test_shared_fields_are_held_once(moved):
    """Displacement and rotation, which differ by a factor of 100, both to the digits of float32."""
    _, motion, phasors = moved
    fields, series = fields_of(motion)
    assert fields.shape == (R, MIXED, 6)
    assert series.shape == (K, R)
    for part in (slice(0, 3), slice(3, 6)):
        again = np.tensordot(series, fields[..., part], axes=1)
        np.testing.assert_allclose(again, phasors[..., part], atol=1e-6 * np.abs(phasors[..., part]).max())


def test_modes_are_the_same_from_few_fields_as_from_their_phasors(moved):
    _, of_phasors, phasors = moved
    fields, series = fields_of(of_phasors)
    few = replace(of_phasors, fields=fields, series=series)
    weights = np.random.default_rng(3).uniform(size=MIXED)
    size = np.abs(phasors[..., :3]).max()
    for one_form in (of_phasors, few):
        np.testing.assert_allclose(one_form.displacement, phasors[..., :3], atol=1e-6 * size)
        np.testing.assert_allclose(one_form.displacement_of(4), phasors[4, :, :3], atol=1e-6 * size)
        np.testing.assert_allclose(one_form.rotation_of(4), phasors[4, :, 3:], atol=1e-4 * size)
        power = np.einsum("knc,n->k", np.abs(phasors[..., :3].astype(complex)) ** 2, weights)
        np.testing.assert_allclose(one_form.powers(weights), power, rtol=1e-5)
        some = one_form.selected(np.arange(K) < 2)
        np.testing.assert_allclose(some.rotation, phasors[:2, :, 3:], atol=1e-4 * size)
    assert len(few.selected(np.arange(K) < 0).fields) == 0
