"""The Jacobian of rendering: against differences of the dense twin in float64, its transpose, motion in pixels."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from tests.fit.motion.scenes import COLUMNS, SCENES, motion_of, view_of
from tests.fit.rasterize.oracle import assert_close
from tests.helpers import dense as reference
from tests.helpers.dense import rasterize_dense
from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.capture import load_capture
from tg4mm.fit.motion.jacobian import view as module
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import ALPHA_MIN_LINEAR, pixels_moved, view_jacobian
from tg4mm.fit.motion.observations import fixed_cameras


def over_white(scene, motion):
    """The twin's picture [H, W, 3] over white, every Gaussian shifted and turned (about the world axes)."""
    shift, turn = motion[:, :3], Rotation.from_rotvec(motion[:, 3:])
    rest = Rotation.from_quat(scene.quats.numpy()[:, [1, 2, 3, 0]])
    quats = (turn * rest).as_quat()[:, [3, 0, 1, 2]]
    image, alpha = rasterize_dense(
        scene.means + torch.from_numpy(shift), torch.from_numpy(quats), scene.scales, scene.opacities,
        scene.colors, scene.viewmats[0], scene.Ks[0], scene.width, scene.height,
    )  # fmt: skip
    return image + 1 - alpha[..., None]


def differences(scene, motion):
    """Central differences along `motion` [H, W, 3], and which pixels [H, W, 1] cross no threshold meanwhile."""
    found = []
    for step in (1e-6, 3e-6):
        d = motion.astype(np.float64) * step
        found.append((over_white(scene, d) - over_white(scene, -d)) / (2 * step))
    # a step is worth its height over 2 · step: three times less at three times the step
    apart = (found[0] - found[1]).abs().amax(-1, keepdim=True)
    return found[0], apart < 1e-4 * found[0].abs().max()


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("columns", COLUMNS)
def test_the_jvp_is_the_derivative_of_the_picture(name, columns, monkeypatch):
    monkeypatch.setattr(reference, "ALPHA_MIN", ALPHA_MIN_LINEAR)
    scene = SCENES[name]
    motion = motion_of(scene, COLUMNS[columns])
    expected, safe = differences(scene, motion)
    assert safe.double().mean() > 0.97
    assert expected.abs().max() > 0.1
    shown = torch.from_numpy(view_of(scene).jvp(motion[None])[0])
    assert_close("change", shown * safe, expected * safe, 3e-4)
    with pytest.raises(AssertionError):  # the comparison can fail
        assert_close("change", shown * safe * 1.002, expected * safe, 3e-4)


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("columns", COLUMNS)
def test_the_vjp_is_the_transpose(name, columns):
    scene = SCENES[name]
    view, motion = view_of(scene), motion_of(scene, COLUMNS[columns])
    for seed in range(3):
        picture = np.random.default_rng(seed).normal(size=(scene.height, scene.width, 3)).astype(np.float32)
        gathered = np.zeros_like(motion)
        view.vjp(picture[None], gathered[None])
        terms = gathered.astype(np.float64) * motion
        forward = (view.jvp(motion[None])[0].astype(np.float64) * picture).sum()
        assert abs(forward - terms.sum()) < 1e-4 * np.linalg.norm(view.jvp(motion[None])[0]) * np.linalg.norm(
            picture
        )
        assert abs(forward - terms.sum()) < 1e-4 * np.abs(terms).sum()


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("n_changes", [1, 3])
@pytest.mark.parametrize("weighted", [False, True])
def test_the_gauss_newton_product_is_one_after_the_other(name, n_changes, weighted):
    scene, rng = SCENES[name], np.random.default_rng(2)
    view, n = view_of(scene), len(scene.means)
    motions = rng.normal(size=(n_changes, n, DOF)).astype(np.float32)
    pixels = rng.uniform(0.1, 1, view.transmittance.shape).astype(np.float32)
    expected = rng.normal(size=motions.shape).astype(np.float32)
    found = expected.copy()  # added to
    pictures = view.jvp(motions)
    view.vjp(pictures * pixels[..., None] if weighted else pictures, expected)
    view.gauss_newton_product(motions, pixels if weighted else None, found)
    np.testing.assert_allclose(found, expected, atol=2e-5 * np.abs(expected).max())


def test_what_nobody_sees_is_not_listed_and_not_missed(monkeypatch):
    crowded = SCENES["crowded"]
    sight, is_behind = crowded.viewmats[0, 2, :3], torch.arange(len(crowded.means)) >= 100
    opaque = replace(
        crowded,
        means=crowded.means + 3.0 * is_behind[:, None] * sight,
        opacities=torch.full_like(crowded.opacities, 0.999),
        scales=4 * crowded.scales,
    )
    view = view_of(opaque)
    monkeypatch.setattr(module, "seen", lambda bins: bins)
    whole = view_of(opaque)
    assert len(view.bins.pair_gaussian) < 0.95 * len(whole.bins.pair_gaussian)
    assert view.bins.n_visible < whole.bins.n_visible
    assert (view.bins.reached != 0).all()
    motions = np.stack([motion_of(opaque, COLUMNS["both"], seed) for seed in range(2)])
    pictures = whole.jvp(motions)
    assert np.abs(pictures).max() > 0.1
    assert np.array_equal(view.jvp(motions), pictures)
    for apply in ("vjp", "gauss_newton_product"):
        found, expected = np.zeros((2, *motions.shape), np.float32)
        for some, out in ((view, found), (whole, expected)):
            if apply == "vjp":
                some.vjp(pictures, out)
            else:
                some.gauss_newton_product(motions, None, out)
        assert np.abs(expected).max() > 0.1
        assert np.array_equal(found, expected), apply


def test_a_stored_view_gives_the_same_before_and_after_it_is_released():
    view, rng = view_of(SCENES["crowded"]), np.random.default_rng(4)
    motions = rng.normal(size=(3, 120, DOF)).astype(np.float32)
    stored = view.stored()
    for _ in range(2):
        own, other = np.zeros_like(motions), np.zeros_like(motions)
        view.gauss_newton_product(motions, None, own)
        stored.gauss_newton_product(motions, None, other)
        assert np.array_equal(own, other)
        assert np.array_equal(view.jvp(motions), stored.jvp(motions))
        stored.release()
    assert stored.nbytes == view.nbytes


@pytest.fixture(scope="module")
def posed(tmp_path_factory):
    root = tmp_path_factory.mktemp("pixels")
    gaussians, _ = make_synthetic_dataset(root, n_views=2, n_timesteps=2, size=32, alphas=(), n_test=0)
    cameras = fixed_cameras(load_capture(root))
    return [view_jacobian(gaussians, camera, (32, 32)) for camera in cameras], gaussians, cameras


def test_a_small_part_that_moves_far_is_not_missed(posed):
    """Three of a hundred Gaussians in view."""
    views, gaussians, cameras = posed
    view = views[0]
    seen = view.bins.order[: view.bins.n_visible]
    shift = np.zeros((len(gaussians), 3))
    shift[seen[::33]] = 0.1 * cameras[0].viewmat[0, :3]
    assert pixels_moved([view], shift[None]) > 0.4


@pytest.mark.parametrize("axis", [0, 1, 2], ids=["right", "down", "along the sight"])
def test_pixels_are_those_between_two_projections(posed, axis):
    """Each Gaussian by another length, along one axis of the camera."""
    views, gaussians, cameras = posed
    view, camera = views[0], cameras[0]
    lengths = np.random.default_rng(axis).uniform(0, 0.02, (len(gaussians), 1))
    shift = (lengths * camera.viewmat[axis, :3]).astype(np.float32)
    seen = view.bins.order[: view.bins.n_visible]
    means = gaussians.means.numpy().astype(np.float64)[seen]
    before, after = _projected(camera, means), _projected(camera, means + shift[seen])
    expected = np.percentile(np.linalg.norm(after - before, axis=1), 99)
    assert pixels_moved([view], shift[None]) == pytest.approx(expected, rel=0.01)


def _projected(camera, points):
    """Pixels [n, 2]."""
    at = np.hstack([points, np.ones((len(points), 1))]) @ camera.viewmat[:3].T @ camera.K.T
    return at[:, :2] / at[:, 2:]
