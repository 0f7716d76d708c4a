"""Changes of colour: how pictures answer to them, that noise is none, and that they are limited."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.fit.motion.scenes import SCENES, camera_of, gaussians_of
from tests.fit.rasterize.oracle import assert_close
from tests.helpers.motion_animate import FREQS, gaussians, motion
from tests.helpers.motion_appearance import N, appearance, change_of
from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.capture import load_capture
from tg4mm.fit.motion import MotionConfig
from tg4mm.fit.motion.animate import animate
from tg4mm.fit.motion.appearance import (
    HARMONIC,
    AppearanceFit,
    AppearanceProblem,
    MotionResidual,
    appearance_views,
)
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import ALPHA_MIN_LINEAR, view_jacobian
from tg4mm.fit.motion.modes import LIMIT
from tg4mm.fit.motion.observations import fixed_cameras
from tg4mm.fit.motion.prior.graph import build_graph
from tg4mm.fit.motion.solver.operator import Fold
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.rasterize import reference
from tg4mm.fit.rasterize.buffers import Buffers
from tg4mm.fit.rasterize.reference import rasterize_dense


def view_of_colours(name, tilts, mean=20.0):
    """The view of Gaussians whose first coefficient is `mean` in all channels."""
    scene = SCENES[name]
    camera = camera_of(scene)
    sh = torch.zeros_like(gaussians_of(scene).sh)
    sh[:, 0] = mean
    view = view_jacobian(replace(gaussians_of(scene), sh=sh), camera, (scene.width, scene.height))
    return appearance_views([view], [camera], scene.means.float().numpy(), tilts)[0]


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("tilts", [True, False])
def test_a_change_shows_as_spherical_harmonics_do(name, tilts, monkeypatch):
    """Against the dense twin in float64. Colours far above 0, where they are not clamped."""
    monkeypatch.setattr(reference, "ALPHA_MIN", ALPHA_MIN_LINEAR)
    scene = SCENES[name]
    change = 0.1 * change_of(len(scene.means), tilts=tilts)
    pictures = []
    for sign in (1, -1):
        sh = torch.zeros_like(scene.colors)
        sh[:, 0] = 20
        sh[:, : change.shape[2]] += sign * torch.from_numpy(change[0]).double() / HARMONIC
        pictures.append(
            rasterize_dense(
                scene.means, scene.quats, scene.scales, scene.opacities, sh, scene.viewmats[0], scene.Ks[0],
                scene.width, scene.height,
            )[0]
        )  # fmt: skip
    shown = view_of_colours(name, tilts).jvp(change, Buffers())[0]
    assert_close("picture", torch.from_numpy(shown.copy()), (pictures[0] - pictures[1]) / 2, 2e-4)


def test_a_colour_below_zero_does_not_answer():
    """It is clamped, so that no small change of it shows."""
    name = next(iter(SCENES))
    change = change_of(len(SCENES[name].means))
    assert np.abs(view_of_colours(name, True).jvp(change, Buffers())).max() > 0.1
    dark = view_of_colours(name, True, mean=-20.0)
    assert not dark.jvp(change, Buffers()).any()
    out = np.zeros_like(change)
    dark.vjp(np.ones((1, *dark.view.transmittance.shape, 3), np.float32), out, Buffers())
    assert not out.any()


@pytest.mark.parametrize("tilts", [True, False])
def test_the_vjp_is_the_transpose_and_the_product_both(tilts):
    view, rng = view_of_colours("crowded", tilts), np.random.default_rng(1)
    x = change_of(120, 2, tilts)
    shown = view.jvp(x, Buffers()).copy()
    pictures = rng.normal(size=shown.shape).astype(np.float32)
    gathered = np.zeros_like(x)
    view.vjp(pictures, gathered, Buffers())
    assert (shown * pictures).sum() == pytest.approx((x * gathered).sum(), rel=1e-3)
    weights = rng.uniform(0.2, 1, shown.shape[1:3]).astype(np.float32)
    both, expected = np.zeros_like(x), np.zeros_like(x)
    view.gauss_newton_product(x, weights, both, Buffers())
    view.vjp(shown * weights[..., None], expected, Buffers())
    np.testing.assert_allclose(both, expected, atol=1e-4 * np.abs(expected).max())


class Lab:
    """Eight cameras around the synthetic scene, and two components: the images of each are made up."""

    def __init__(self, root):
        self.gaussians, _ = make_synthetic_dataset(
            root, n_views=8, n_timesteps=2, size=48, alphas=(), n_test=0
        )
        self.means = self.gaussians.means.numpy()
        self.cameras = fixed_cameras(load_capture(root))
        self.views = [view_jacobian(self.gaussians, camera, (48, 48)) for camera in self.cameras]
        axes = np.tile(np.eye(3), (len(self.means), 1, 1))
        self.graph = build_graph(self.means, axes, self.gaussians.scales.numpy())
        self.colours = appearance_views(self.views, self.cameras, self.means, True)
        self.shapes = np.zeros((2, len(self.means), DOF), np.float32)
        self.shapes[0, :, 1] = 0.003

    def fitted(self, pictures, shapes=None, rows=(0, 1)):
        problem = AppearanceProblem.of(self.colours, None, self.graph)
        folds = [Fold(np.arange(0, 8, 2)), Fold(np.arange(1, 8, 2))]
        shapes = self.shapes if shapes is None else shapes
        motion = Problem.of(self.views, self.gaussians, MotionConfig(), "cpu")
        residual = MotionResidual(motion, pictures, np.array(rows, np.int64), shapes[list(rows)])
        return AppearanceFit(problem, folds, self.graph.knn).fitted(residual)

    def shown(self, x, shapes):
        both = zip(self.views, self.colours, strict=True)
        return np.stack([view.jvp(shapes) + colours.jvp(x, Buffers()) for view, colours in both])

    def patch(self):
        """[2, N, 4, 3]: a shadow on the floor in the first component, that looks darker from one side."""
        x = np.zeros((2, len(self.means), 4, 3), np.float32)
        size = 0.02 * np.exp(-8 * ((self.means - [0.3, -0.5, 0.0]) ** 2).sum(1))
        x[0, :, 0] = -size[:, None]
        x[0, :, 3] = 0.4 * size[:, None]
        return x


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    return Lab(tmp_path_factory.mktemp("light") / "data")


def noise(lab, size):
    rng = np.random.default_rng(3)
    return (size * rng.normal(size=(8, 2, 48, 48, 3))).astype(np.float32)


def test_a_change_of_colour_is_told_from_motion_and_noise(lab):
    """Noise of a tenth of the patch's peak in every pixel; only the first component holds a change."""
    x = lab.patch()
    pictures = lab.shown(x, lab.shapes) + noise(lab, 0.002)
    found, gains = lab.fitted(pictures)
    assert gains[0] > 0.8
    assert gains[1] == 0
    assert not found[1].any()
    # what the cameras see of it: all are above, so they cannot tell the colour's mean from its tilt along z
    off = lab.shown(found * np.float32(HARMONIC), lab.shapes) - lab.shown(x, lab.shapes)
    assert np.linalg.norm(off[:, 0]) < 0.3 * np.linalg.norm(lab.shown(x, 0 * lab.shapes)[:, 0])
    far = np.linalg.norm(lab.means - [0.3, -0.5, 0.0], axis=1) > 1
    assert np.abs(found[0][far]).max() < 0.1 * np.abs(found[0]).max()


def test_noise_alone_has_none(lab):
    found, gains = lab.fitted(lab.shown(0 * lab.patch(), lab.shapes) + noise(lab, 0.01))
    assert not gains.any()
    assert not found.any()


def change_at(m, t, alpha, band=None):
    g = gaussians()
    return (animate(g, m, t, alpha, band).sh - g.sh).numpy()


def by_hand(own, t, factors):
    turn = np.exp(2j * np.pi * FREQS * t / 30) * factors
    return np.einsum("r,rnkc->nkc", (turn @ own.series).real, own.shapes)


def test_magnified_it_has_a_limit_and_keeps_its_direction():
    m = replace(motion(), appearance=appearance(0.1))
    change, plain = change_at(m, 3, 1e6), by_hand(m.appearance, 3, [1e6 + 1] * 3)
    sizes = np.linalg.norm(change.reshape(N, -1), axis=1) * HARMONIC
    np.testing.assert_allclose(sizes, LIMIT, rtol=1e-4)
    cosine = (change * plain).sum((1, 2)) / np.linalg.norm(plain.reshape(N, -1), axis=1) * HARMONIC / LIMIT
    np.testing.assert_allclose(cosine, 1, rtol=1e-4)
