"""Before the fit: components that are noise, pixel weights from them, and the smoothness weight."""

import warnings
from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tests.fit.motion.scenes import gaussians_of, view_of
from tests.fit.rasterize.oracle import make_scene
from tests.fit.space.scenes import capture_of
from tests.helpers.motion_temporal import components
from tg4mm.fit.motion import hyperparameters
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.hyperparameters import (
    CANDIDATES,
    DEFAULT,
    LEAST,
    chosen_weight,
    few_iterations,
    noise_components,
    pixel_noise,
    pixel_weights,
    select_smoothness,
    smoothest,
)
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.observations import observe
from tg4mm.fit.motion.solver.cuda import DeviceOperator, DeviceViews
from tg4mm.fit.motion.solver.operator import Fold
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.targets import TargetImages

N, CAMERAS = 80, 8
FOLDS = [Fold(np.arange(CAMERAS)[::2]), Fold(np.arange(CAMERAS)[1::2])]
SIZE, VIEWS = 40, 3
EVENED = 4 * np.pi * 1.5**2  # independent pixels in a Gaussian mean of 1.5 px


@pytest.fixture(scope="module")
def problem():
    """Eight cameras look at one cloud."""
    scene = make_scene(1, n=N, cameras=CAMERAS)
    views = [view_of(scene, c) for c in range(CAMERAS)]
    return Problem.of(views, gaussians_of(scene), MotionConfig(), "cpu")


@pytest.fixture(params=["kernels", "torch device"])
def anywhere(problem, request):
    """Also with the operators that a GPU has, on the CPU's tensors."""
    return problem if request.param == "kernels" else OnTensors.of(problem)


class OnTensors(Problem):
    @staticmethod
    def of(problem):
        return OnTensors(**{f.name: getattr(problem, f.name) for f in fields(Problem)})

    def operator(self, *args, **more):
        operator = self.on_cpu(*args, **more)
        return DeviceOperator(operator, DeviceViews(operator.views, operator.graph, "cpu"))


def moved(u):
    """Displacements [N, 3] without rotation, [N, DOF]."""
    return np.concatenate([u, np.zeros((len(u), DOF - 3))], 1).astype(np.float32)


def shown(p, u, noise, seed=2):
    """Target images [V, 1, H, W, 3] of a displacement, with noise as a share of their rms."""
    pictures = np.stack([view.jvp(moved(u)[None]) for view in p.views])
    spread = noise * np.sqrt((pictures**2).mean())
    return (pictures + np.random.default_rng(seed).normal(0, spread, pictures.shape)).astype(np.float32)


def each_by_itself(seed=1):
    return np.random.default_rng(seed).normal(size=(N, 3)).astype(np.float32)


def as_one():
    return np.tile(np.float32([1, -0.5, 0.3]), (N, 1))


def weight_for(p, images):
    return chosen_weight(images, p, FOLDS, 4)


def targets(images):
    n, size = images.shape[1], (len(images), *images.shape[2:4])
    basis = np.eye(n, 10)
    return TargetImages(basis, np.ones(10), images, np.zeros(size, np.float32), n, images[:, 0])


class TestSmoothness:
    def test_noise_asks_for_more_of_it(self, problem):
        """All move nearly as one; no noise, and thirty times the pictures' rms, with chance in every draw."""
        little, much = (
            [
                weight_for(problem, shown(problem, as_one() + 0.3 * each_by_itself(k), noise, k))
                for k in range(6)
            ]
            for noise in (0.0, 30.0)
        )
        assert np.log(much).mean() > np.log(2) + np.log(little).mean()

    def test_the_operators_of_a_gpu_give_the_same(self, problem):
        images = shown(problem, as_one() + 0.3 * each_by_itself(), 1.0)
        assert weight_for(OnTensors.of(problem), images) == pytest.approx(
            weight_for(problem, images), rel=1e-3
        )

    @pytest.mark.parametrize("still", [[0], [1], [0, 1]])
    def test_a_fold_that_does_not_change_says_nothing(self, problem, still):
        pictures = shown(problem, each_by_itself(), 0.0)
        for fold in still:
            pictures[FOLDS[fold].views] = 0
        assert weight_for(problem, pictures) == DEFAULT

    def test_the_other_fold_is_the_judge(self, problem):
        """The first shows a motion of each by itself; it is held back where the second shows the opposite."""
        pictures = shown(problem, each_by_itself(), 0.0)
        believed = weight_for(problem, pictures)
        pictures[FOLDS[1].views] *= -1
        assert weight_for(problem, pictures) > 10 * believed

    def test_candidates_that_share_their_passes_are_each_by_itself(self, problem):
        operators = [problem.on_cpu(FOLDS[0], weight) for weight in CANDIDATES[:3]]
        images = [shown(problem, as_one(), 0.5)[v] for v in FOLDS[0].views]
        together = few_iterations(operators, images, 3)
        for operator, found in zip(operators, together, strict=True):
            (alone,) = few_iterations([operator], images, 3)
            np.testing.assert_allclose(found, alone, atol=1e-4 * np.abs(alone).max())

    def test_a_weight_that_is_given_stands(self, problem):
        images = shown(problem, each_by_itself(), 0.0)
        given = replace(problem, config=replace(problem.config, smoothness_weight=77.0))
        assert select_smoothness(images, given, FOLDS) == 77.0
        assert select_smoothness(images, problem, FOLDS) == pytest.approx(LEAST)

    @pytest.mark.parametrize("noise", [100.0, 1_000.0])
    @pytest.mark.parametrize("best", [150.0, 1_234.0, 40_000.0])
    def test_the_best_weight_may_lie_between_candidates_however_large_the_noise_is(self, best, noise):
        """The expected one is the last of many, 0.02 apart in the logarithm, that explains 98 % of the most."""
        few, many = (
            smoothest(weights, noise - 0.5 / (1 + np.log(weights / best) ** 2 / 8), noise)
            for weights in (np.array(CANDIDATES), np.geomspace(LEAST, CANDIDATES[-1], 300))
        )
        assert best < few < 3 * best
        assert -0.021 < np.log(many / best) - np.sqrt(8 * (1 / 0.98 - 1)) < 0.001

    @pytest.mark.parametrize(("gain", "tried"), [(0.1, 9), (0.001, 7), (-0.1, 7)])
    def test_weights_are_tried_until_the_error_falls_no_more(self, monkeypatch, gain, tried):
        """gain: of each candidate over the one before, where no motion leaves an error of 100 and the first one 99."""
        asked = []

        def fields_of(weights, *_):
            asked.extend(weights)
            return [np.array([weight]) for weight in weights]

        def misfit(field, _):
            return 99 - gain * np.log(field[0] / LEAST) / np.log(10**0.75) if field.any() else 100.0

        monkeypatch.setattr(hyperparameters, "few_iterations", fields_of)
        judge = SimpleNamespace(misfit=misfit)
        posed = SimpleNamespace(
            operator=lambda fold, weight: judge if fold is FOLDS[1] else weight,
            aggregates=SimpleNamespace(has_patches=False),
        )
        found = chosen_weight(np.ones((CAMERAS, 1)), posed, FOLDS, 4)
        np.testing.assert_allclose(asked, LEAST * 10 ** (0.75 * np.arange(tried)))
        assert found == pytest.approx(asked[-1] if gain > 0 else LEAST)

    def test_of_weights_that_hardly_differ_it_is_a_large_one_though_the_least_is_best(self):
        """The errors of a generated scene of 256×256 pixels, whose displacement error is 13 % at 10 and 4 % at 300."""
        errors = np.array([0.34398, 0.34416, 0.34476, 0.34517, 0.34558, 0.34779, 0.35623])
        assert 100 < smoothest(np.array(CANDIDATES), errors, 1.0) < 500

    def test_of_weights_that_are_alike_it_is_the_largest(self):
        """All explain the same, but for a part in a hundred."""
        explained = 10 + 0.1 * np.cos(1 + np.arange(len(CANDIDATES)))
        assert smoothest(np.array(CANDIDATES), 100 - explained, 100.0) == pytest.approx(CANDIDATES[-1])

    @pytest.mark.parametrize("noise", [1.0, 3.0])
    def test_motion_of_all_as_one_in_noise_is_held_as_firmly(self, problem, noise):
        """In most draws of noise the least error lies at the end of the first candidates, or beyond."""
        found = [weight_for(problem, shown(problem, as_one(), noise, seed)) for seed in range(5)]
        assert np.median(found) >= 0.9 * CANDIDATES[-1]


class TestNoise:
    def test_noise_is_distinguished_from_motion(self, anywhere):
        """Motion with as much noise as signal, noise alone of the same energy, motion without noise."""
        moving = shown(anywhere, as_one(), 1.0)
        noise = np.random.default_rng(3).normal(0, np.sqrt((moving**2).mean()), (*moving.shape, 5))
        other = shown(anywhere, as_one()[:, ::-1].copy(), 0.0)
        images = np.concatenate([moving, *np.moveaxis(noise.astype(np.float32), -1, 0), other], 1)
        found = noise_components(targets(images), anywhere, FOLDS)
        assert not found[[0, -1]].any()
        assert found[1:-1].sum() >= 4  # the fields are so smooth that two of noise may agree by chance

    def test_sinusoids_of_known_frequencies_are_not_asked(self, problem):
        """Mixed, they are one system, of which none is noise by itself."""
        images = shown(problem, as_one(), 0.0).repeat(2, axis=1)
        images[FOLDS[1].views, 1] *= -1  # nothing that both folds show
        mixed = problem.changed(mixing=[np.eye(2, dtype=np.float32)] * CAMERAS)
        assert not noise_components(targets(images), mixed, FOLDS).any()
        assert noise_components(targets(images), problem, FOLDS).tolist() == [False, True]


class TestPixels:
    def test_they_count_less_the_more_they_flicker(self):
        """The left half flickers three times as much as the right: 1 / (1 + 9/5), 1 / (1 + 1/5); the mean is 5."""
        images = np.random.default_rng(0).normal(size=(2, 2, 60, 80, 3)).astype(np.float32)
        images[:, 1, :, :40] *= 3
        weights = pixel_weights(targets(images), np.array([False, True]))
        assert weights.dtype == np.float32
        assert weights[:, :, 5:35].mean() == pytest.approx(1 / (1 + 9 / 5), rel=0.1)
        assert weights[:, :, 45:75].mean() == pytest.approx(1 / (1 + 1 / 5), rel=0.1)
        assert 0 < weights.min() < weights.max() <= 1
        assert pixel_weights(targets(images), np.array([False, True]), are_separate=False) is None


def deviation():
    """[V, H, W] standard deviation of a picture's noise: 0.005 to 0.04, smooth, another in every camera."""
    x = np.linspace(0, np.pi, SIZE)
    wave = np.sin(x)[:, None] * np.sin(x)
    return 0.005 + 0.035 * np.stack([wave, wave[::-1, :] ** 2, 1 - wave])


def noisy(n_timesteps, motion):
    """Components of pictures of 16 bits: grey, noise of known deviation, a pattern that swings."""
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(n_timesteps, VIEWS, SIZE, SIZE, 3)) * deviation()[..., None]
    swing = np.sin(2 * np.pi * np.arange(n_timesteps) / n_timesteps)
    pattern = motion * rng.normal(size=(VIEWS, SIZE, SIZE, 3))
    values = 0.5 + noise + swing[:, None, None, None, None] * pattern
    data = np.full((n_timesteps * VIEWS, SIZE, SIZE, 4), 65535, np.uint16)
    data[..., :3] = (values.clip(0, 1) * 65535).round().reshape(-1, SIZE, SIZE, 3)
    ids = list(range(VIEWS)) * n_timesteps
    capture, images = capture_of(ids, sorted(list(range(n_timesteps)) * VIEWS), data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return components(observe(capture, images), 16)


def check(found, freedom):
    """Within five standard errors of a mean over `freedom` × three channels × the pixels that are evened out.

    The mean of all pixels has √(pixels) times less, and tells a wrong number of degrees of freedom.
    """
    true = gaussian_filter(deviation() ** 2, (0, 1.5, 1.5), mode="reflect")
    error = found / true - 1
    one = np.sqrt(2 / (3 * freedom * EVENED))
    assert np.abs(error[:, 5:-5, 5:-5]).max() < 5 * one
    whole = np.sqrt(2 / (3 * freedom * error.size)) * 1.5  # 1.5: pixels of large noise weigh more
    assert abs(found.sum() / true.sum() - 1) < 4 * whole
    assert np.abs(0.8 * found.sum() / true.sum() - 1) > 4 * whole  # it can fail


class TestNoiseOfKnownVariance:
    def test_beside_motion_what_is_left_tells(self):
        """A component of motion, eight times the noise, is kept and not named noise: 28 are left."""
        found = noisy(30, 0.08)
        assert len(found.basis) == 1
        variance = pixel_noise(found, np.array([False]))
        check(variance, 28)
        assert pixel_noise(found, np.array([True])).mean() > 3 * variance.mean()


class TestExactly:
    def test_energy_is_divided_among_kept_and_left_out(self):
        """Made up: residual 6 of rank 5 with two kept, the second of energy 2 in one pixel, before evening out."""
        images = np.zeros((1, 2, 9, 9, 3), np.float32)
        images[0, 1] = np.sqrt(2.0)
        images[0, 0] = 100.0
        left = np.full((1, 9, 9), 6.0, np.float32)
        targets = TargetImages(np.zeros((2, 8)), np.zeros(8), images, left, 5, images[:, 0])
        found = pixel_noise(targets, np.array([False, True]))
        np.testing.assert_allclose(found, (6 + 2) / (3 + 1), rtol=1e-5)
        np.testing.assert_allclose(pixel_noise(targets, np.array([False, False])), 6 / 3, rtol=1e-5)
