"""Changes of colour: how pictures answer to them, that noise is none, and that they are limited.

Appearance through the whole stage: a shadow that goes with the motion is found, saved and magnified.

AppearanceModes in a run's motion file: beside the motion, optional, and only where it fits.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.fit.motion.scenes import SCENES, camera_of, gaussians_of
from tests.fit.rasterize.oracle import assert_close
from tests.helpers import dense as reference
from tests.helpers import synthetic
from tests.helpers.dense import rasterize_dense
from tests.helpers.motion_animate import FREQS, N, alphas, gaussians, motion
from tests.helpers.runs import copied
from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.capture import load_capture, load_images
from tg4mm.core.errors import RunError
from tg4mm.core.magnification import Magnification
from tg4mm.core.memory import Buffers
from tg4mm.fit.gaussians import Gaussians
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
from tg4mm.fit.motion.modes import LIMIT, AppearanceModes
from tg4mm.fit.motion.observations import fixed_cameras
from tg4mm.fit.motion.prior import build_graph
from tg4mm.fit.motion.solver.operator import Fold
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.run import Run
from tg4mm.run.preset import poses_of
from tg4mm.run.stages import train_motion

DARK = 0.015  # peak of the shadow's change, of 1: four levels of 8 bits


def change_of(n, changes=1, tilts=True, seed=0):
    """Random changes of colour [changes, n, K, 3]."""
    size = (changes, n, 4 if tilts else 1, 3)
    return np.random.default_rng(seed).normal(size=size).astype(np.float32)


def appearance(size=1e-3, modes=3):
    rng = np.random.default_rng(5)
    series = rng.normal(size=(modes, 2)) + 1j * rng.normal(size=(modes, 2))
    return AppearanceModes(size * change_of(N, 2, seed=6), series)


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


def test_a_change_of_colour_is_distinguished_from_motion_and_noise(lab):
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
    return (animate(g, m, t, alphas(m, alpha, band)).sh - g.sh).numpy()


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


def shadow(means):
    """[N] how much darker each Gaussian gets at most: a soft patch on the floor."""
    away = ((means - torch.tensor([0.45, -0.6, 0.0])) ** 2).sum(1)
    return DARK * torch.exp(-4 * away) * (means[:, 2] < 0.01)


def true_sh(gaussians, t, alpha):
    """3 Hz in the post's phase."""
    sh = gaussians.sh.clone()
    now = (1 + alpha) * np.sin(2 * np.pi * 3 * t / 30)
    sh[:, 0] -= (now * shadow(gaussians.means) / HARMONIC)[:, None]
    return sh


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Eight cameras, ten timesteps, post and ball swaying at 3 Hz while a shadow comes and goes."""
    root = tmp_path_factory.mktemp("shaded")
    plain = synthetic._at

    def shaded(gaussians, motion, t, alpha):
        at = plain(gaussians, motion, t, alpha)
        return Gaussians(at.means, at.quats, at.scales, at.opacities, true_sh(gaussians, t, alpha))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(synthetic, "_at", shaded)
        run, _ = synthetic.exact_run(root, n_views=8, n_timesteps=10, size=48, amplitude=0.005)
    capture = load_capture(root / "data")
    return run, capture, load_images(capture)


@pytest.fixture(scope="module")
def trained(made, tmp_path_factory):
    run = copied(made[0], tmp_path_factory.mktemp("trained") / "run")
    train_motion(run, *made[1:], MotionConfig())
    return run


def changes(run, t, alpha):
    """[N, 3] change of colour, mean over all directions."""
    at = poses_of(run, Magnification(everywhere=alpha)).at(t)
    return ((at.sh - run.load_space().sh)[:, 0] * HARMONIC).numpy()


@pytest.mark.parametrize(("alpha", "bound"), [(0.0, 0.5), (4.0, 0.55)])
def test_the_shadow_is_found_and_magnified(trained, alpha, bound):
    """Error .40: motion of the checkered floor explains some of it, and smoothness takes some. Nothing found: 1."""
    gaussians = trained.load_space()
    where = (shadow(gaussians.means) > 0.3 * DARK).numpy()
    assert where.sum() > 8
    for t in (2, 3, 7):
        true = ((true_sh(gaussians, t, alpha) - gaussians.sh)[:, 0] * HARMONIC).numpy()
        off = (changes(trained, t, alpha) - true)[where]
        assert np.linalg.norm(off) < bound * np.linalg.norm(true[where])


def test_it_is_taken_away_with_its_motion(trained):
    most = np.abs(changes(trained, 2, 0.0)).max()
    assert most > 0.4 * DARK
    assert np.abs(changes(trained, 2, -1.0)).max() < 1e-3 * most


def test_the_log_tells_what_was_found(trained):
    gains = trained.log()["motion"]["appearance_reliability"]
    assert gains[0] > 0.7
    assert all(0 <= g <= 1 for g in gains)


def test_the_shadow_is_not_taken_for_motion(trained, made, tmp_path):
    """The floor under it stands still. The motion's second pass is fitted without what appearance explains."""
    run = copied(made[0], tmp_path / "run")
    plain = train_motion(run, *made[1:], MotionConfig(appearance=False))
    assert plain.appearance is None
    assert "appearance_reliability" not in run.log()["motion"]
    shaded = trained.load_motion()
    assert shaded is not None
    dark = (shadow(trained.load_space().means) > 0.3 * DARK).numpy()
    moves = [np.linalg.norm(m.displacement[:, dark]) for m in (shaded, plain)]
    assert moves[0] < 0.7 * moves[1]


@pytest.fixture
def run(tmp_path):
    run = Run.create(tmp_path / "run", tmp_path, "modal", {})
    run.save_space(gaussians(), {})
    return run


def test_what_is_read_back_equals_that_written(run):
    m = replace(motion(), appearance=appearance())
    run.save_motion(m, {})
    back = run.load_motion()
    assert back.appearance.shapes.dtype == np.float32
    np.testing.assert_array_equal(back.appearance.shapes, m.appearance.shapes)
    np.testing.assert_array_equal(back.appearance.series, m.appearance.series)


@pytest.mark.parametrize(
    "bad",
    [
        AppearanceModes(change_of(N - 1, 2), appearance().series),
        AppearanceModes(change_of(N, 2), appearance(modes=2).series),
        AppearanceModes(change_of(N, 3), appearance().series),
        AppearanceModes(
            np.zeros((2, N, 9, 3), np.float32), appearance().series
        ),  # more than the Gaussians have
        AppearanceModes(
            change_of(N, 2)[:, :, :2], appearance().series
        ),  # neither the mean alone nor with all tilts
        AppearanceModes(change_of(N, 2).astype(np.float64), appearance().series),
        AppearanceModes(change_of(N, 2), appearance().series.real),
    ],
)
def test_what_does_not_fit_is_refused(run, bad):
    with pytest.raises(RunError, match=r"motion to save: light has shapes \(.*expected \[R, 20, 1 or 4"):
        run.save_motion(replace(motion(), appearance=bad), {})
    assert not run.has_motion
