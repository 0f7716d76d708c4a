"""benchmarks/bounds.py: its smooth motions add up to a shift, its noise is that of the pictures, its bound holds."""

import numpy as np
import pytest

from benchmarks.bounds import BoundedRun, _noise, basis_fields, bound_of, part_fields
from tests.fit.motion.scenes import gaussians_of, view_of
from tests.fit.rasterize.oracle import make_scene
from tg4mm.capture.truth_file import Truth, TruthObject
from tg4mm.fit.gaussians import rotation_matrices
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.motion.prior import build_graph

N, CAMERAS, POINTS = 150, 6, 5


@pytest.fixture(scope="module")
def scene():
    made = make_scene(1, n=N, cameras=CAMERAS)
    gaussians = gaussians_of(made)
    axes = rotation_matrices(gaussians.quats).numpy()
    graph = build_graph(gaussians.means.numpy(), axes, gaussians.scales.numpy())
    return gaussians, [view_of(made, c) for c in range(CAMERAS)], graph


def test_smooth_motions_add_up_to_a_shift_without_rotation(scene):
    gaussians, _, graph = scene
    basis = basis_fields(gaussians.means.numpy(), np.ones(N), graph, POINTS, is_affine=False)
    assert basis.shape == (3 * POINTS, N, 6)
    for axis in range(3):
        shift = basis[axis::3].sum(0)
        np.testing.assert_allclose(shift[:, :3], np.eye(3)[[axis]].repeat(N, 0), atol=1e-5)
        np.testing.assert_allclose(shift[:, 3:], 0, atol=1e-4 * np.abs(basis[..., 3:]).max())


@pytest.mark.parametrize("seed", range(3))
def test_noise_is_that_of_courses_without_motion(seed):
    rng, n = np.random.default_rng(seed), 12
    t = np.arange(n)
    course = np.cos(2 * np.pi * 2 * t / n)[None] * np.sqrt(2 / n)
    moved = 5 * course[0][None, :, None, None, None] * rng.normal(size=(2, 1, 40, 40, 3))
    variances = _noise((moved + 0.1 * rng.normal(size=(2, n, 40, 40, 3))).astype(np.float32), course)
    assert np.mean(variances) == pytest.approx(0.01, rel=0.05)


def test_least_squares_in_a_basis_meets_its_bound(scene):
    """Motion of the basis itself, found from noisy pictures: the error over many draws is what the bound says."""
    gaussians, views, graph = scene
    rng = np.random.default_rng(0)
    basis = basis_fields(gaussians.means.numpy(), np.ones(N), graph, POINTS, is_affine=False)
    true = np.tensordot(rng.normal(size=len(basis)), basis, 1)[None].astype(np.float32)
    shape = views[0].transmittance.shape
    sd = 0.3 * np.sqrt(np.mean([view.jvp(true) ** 2 for view in views]))
    nothing = ModalMotion.of_phasors(
        np.zeros(0), np.zeros((0, N, 3), np.complex64), np.zeros((0, N, 3), np.complex64), 30, 12
    )
    variances = np.full((CAMERAS, *shape), sd**2, np.float32)
    subject = BoundedRun(gaussians, np.ones(N), nothing, views, true, variances)
    noise, bound = bound_of(subject, basis)
    jacobian = np.concatenate([v.jvp(basis).reshape(len(basis), -1) for v in views], 1).astype(float)
    errors = []
    for _ in range(20):
        data = np.concatenate([v.jvp(true).ravel() for v in views])
        data = data + sd * rng.normal(size=data.shape)
        found = np.linalg.lstsq(jacobian.T, data, rcond=None)[0]
        off = (np.tensordot(found, basis, 1) - true[0])[:, :3]
        errors.append((off**2).sum() / (true[..., :3] ** 2).sum())
    assert noise <= bound
    assert np.sqrt(np.mean(errors)) == pytest.approx(bound, rel=0.3)


def test_parts_turn_like_rigid_bodies_and_leave_the_others_at_rest():
    """A turn about z is u = (−y, x, 0) with a rotation of (0, 0, 1); it is a sum of one part's affine motions."""
    rng = np.random.default_rng(0)
    cubes = [rng.uniform(-1, 1, (40, 3)) + [shift, 0, 0] for shift in (0.0, 5.0)]
    bodies = [
        TruthObject(str(i), x, np.zeros((0, 3), int), np.zeros((0, 40, 3))) for i, x in enumerate(cubes)
    ]
    truth = Truth(np.zeros(0), tuple(bodies), 30.0, 6)
    means = np.concatenate(cubes).astype(np.float32)
    basis = part_fields(truth, means)
    assert basis.shape == (2 * 12, 80, 6)
    assert not np.concatenate([basis[:12, 40:], basis[12:, :40]]).any()
    turn = np.stack([-means[:40, 1], means[:40, 0], *np.zeros((3, 40)), np.ones(40)], 1)
    moves, target = (x[..., :3].reshape(*x.shape[:-2], -1) for x in (basis[:12, :40], turn))
    found = np.linalg.lstsq(moves.T, target, rcond=None)[0]
    np.testing.assert_allclose(np.tensordot(found, basis[:12, :40], 1), turn, atol=1e-4)
