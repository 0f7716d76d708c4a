"""How uncertain the motion is: noise by two halves, and what is left of the pictures and varies among neighbours.

One camera: along its line of sight the motion is less certain than across, and the truth lies where it says.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import splu

from tests.helpers.synthetic import exact_run, make_synthetic_dataset
from tg4mm.capture import Capture, load_capture, load_images
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion import ModalMotion, MotionConfig
from tg4mm.fit.motion.amplitude_bias import LACKING, PictureGain
from tg4mm.fit.motion.animate import displacement_at
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import ViewJacobian, along_and_across, view_jacobian
from tg4mm.fit.motion.observations import PosedFrames, fixed_cameras
from tg4mm.fit.motion.prior import nearest, stiffness_root
from tg4mm.fit.motion.solver.pcg import pcg
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.uncertainty import BLOCK, MotionEstimate, residual_displacement, unseen_motion
from tg4mm.research.evaluate.displacement import mean_squares
from tg4mm.research.evaluate.scores import uncertainty_figures
from tg4mm.run import UNCERTAINTY, Run
from tg4mm.run.stages import train_motion
from tg4mm.show.maps import blending_weights

SIZE = 4 * BLOCK * 3 + 2  # the last blocks are cut off
BALL = 252  # the last Gaussians


@dataclass(frozen=True)
class Seen:
    capture: Capture
    gaussians: Gaussians
    motion: ModalMotion
    cameras: list[PosedFrames]
    views: list[ViewJacobian]

    @property
    def knn(self):
        return nearest(self.gaussians.means.numpy())[1]

    def left(self, left):
        nothing = np.zeros((2, 0, len(self.gaussians), 6), np.float32)
        return residual_displacement(
            MotionEstimate(nothing, nothing[0], self.gaussians, self.knn, self.views, self.cameras, left)
        )

    def shows(self, displacement):
        """[1, H, W, 3] of each view: what it changes if everything moves."""
        fields = np.zeros((1, len(self.gaussians), DOF), np.float32)
        fields[..., :3] = displacement
        return [view.jvp(fields) for view in self.views]

    def weights(self):
        return blending_weights(self.gaussians, self.capture)


def _views(gaussians, cameras, size):
    return [view_jacobian(gaussians, camera, (size, size)) for camera in cameras]


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """Ten cameras; the Gaussians are exact. The post sways, the ball moves, the floor stands still."""
    root = tmp_path_factory.mktemp("uncertainty") / "data"
    gaussians, motion = make_synthetic_dataset(
        root, n_views=10, n_timesteps=5, size=SIZE, freqs=(6.0,), amplitude=0.01, alphas=(), n_test=0
    )
    capture = load_capture(root)
    cameras = fixed_cameras(capture)
    return Seen(capture, gaussians, motion, cameras, _views(gaussians, cameras, SIZE))


@pytest.mark.parametrize("share", [1.0, 0.8, 0.4])
def test_pictures_tell_how_much_of_the_motion_was_found(seen, share):
    rng = np.random.default_rng(0)
    problem = Problem.of(seen.views, seen.gaussians, MotionConfig(), "cpu")
    true = np.zeros((1, len(seen.gaussians), DOF), np.float32)
    true[..., 0] = 0.01
    gain = PictureGain()
    for v, view in enumerate(seen.views):
        noise = 0.01 * rng.standard_normal((1, SIZE, SIZE, 3)).astype(np.float32)
        gain.add(problem, v, share * true, view.jvp(true) + noise)
    assert gain.ratio == pytest.approx(1 / share, rel=0.05)
    lacking = np.sqrt(gain.squares(share * true))
    assert lacking == pytest.approx(min(1 - share, share * (LACKING - 1)) * 0.01, abs=5e-4)


def test_what_is_left_of_a_shift_is_a_part_of_it_on_each_scale(seen):
    """For a scene that moves as a whole and whose motion was missed, in any direction and in pictures of any size."""
    weights = seen.weights()
    for shift in ((0.01, 0, 0), (0, 0.02, 0), (0.005, 0.005, 0.01)):
        found = seen.left(seen.shows(shift))
        share = (weights * found).sum() / weights.sum() / np.dot(shift, shift)
        assert 0.05 < share < 0.6  # the rest is along the sight, along edges, or cancels within a block
    twice = [replace(c, K=np.diag([2, 2, 1]).astype(np.float32) @ c.K) for c in seen.cameras]
    larger = replace(seen, cameras=twice, views=_views(seen.gaussians, twice, 2 * SIZE))
    left = (np.average(own.left(own.shows((0.01, 0, 0))), weights=weights) for own in (larger, seen))
    ratio = next(left) / next(left)
    assert 0.5 < ratio < 2  # a block is a smaller part of what it shows


def test_it_goes_by_the_square_and_noise_counts_little(seen):
    left = seen.shows((0.01, 0, 0))
    once, twice = seen.left(left), seen.left([2 * pictures for pictures in left])
    np.testing.assert_allclose(twice, 4 * once, rtol=1e-4)
    assert not seen.left([0 * pictures for pictures in left]).any()
    rng = np.random.default_rng(1)
    # Of the same power everywhere.
    noise = [rng.choice([-1, 1], p.shape).astype(np.float32) * p for p in left]
    weights = seen.weights()
    assert (weights * seen.left(noise)).sum() < 0.35 * (weights * once).sum()
    np.testing.assert_allclose(seen.left([np.concatenate([p, p]) for p in left]), 2 * once, rtol=1e-4)


def test_a_run_knows_how_far_off_it_is(seen, tmp_path):
    """Within two deviations for most of what is seen, where noise alone says much too little, and not far too much."""
    run = Run.create(tmp_path / "run", seen.capture.root, "modal", {})
    run.save_space(seen.gaussians, {})
    train_motion(run, seen.capture, load_images(seen.capture), MotionConfig())
    found = run.load_motion()
    found = found.selected(found.freqs_hz > 0)
    part, log = run.load_part(UNCERTAINTY)[0], run.log()["motion"]
    weights = seen.weights()
    said, noise = (
        uncertainty_figures(found, seen.motion, weights, part[name].numpy())
        for name in ("displacement", "noise")
    )
    assert said["within_two"] > 0.85
    assert noise["within_two"] < said["within_two"] - 0.2
    assert 0.5 < said["said"] / said["error"] < 3
    # and it tells places apart: the surer half is off by less
    error, order = mean_squares(found, seen.motion)[0], np.argsort(part["displacement"].numpy())
    surer, others = (np.average(error[o], weights=weights[o]) for o in np.array_split(order, 2))
    assert surer < 0.25 * others
    assert log["uncertainty_to_motion"] > log["noise_to_motion"] > 0


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A run of one camera, the true motion, the camera: the post sways across its sight, the ball mostly along it."""
    root = tmp_path_factory.mktemp("one")
    run, motion = exact_run(root, n_views=1, n_timesteps=5, size=48, freqs=(6.0,), amplitude=0.01)
    capture = load_capture(run.dataset)
    train_motion(run, capture, load_images(capture), MotionConfig())
    return run, motion, fixed_cameras(capture)[0]


def _errors(run, true, axis):
    """[N] rms over time of the error along `axis` [N, 3]."""
    found = run.load_motion()
    assert found is not None
    each = [displacement_at(found, t) - displacement_at(true, t) for t in range(true.n_timesteps)]
    along = np.einsum("tnc,nc->tn", np.stack(each), axis)
    return np.sqrt((along**2).mean(0))


def _seen(run, camera):
    view = view_jacobian(run.load_space(), camera, (48, 48))
    seen = np.zeros(len(run.load_space()), bool)
    seen[view.bins.order[: view.bins.n_visible]] = True
    return seen


def _share_within_two(error, deviation):
    return float((error < 2 * deviation).mean())


def test_the_truth_of_a_scene_lies_within_two_deviations(trained):
    """Across, everywhere; along, of what is seen to move or stand still across."""
    run, true, camera = trained
    part, _ = run.load_part(UNCERTAINTY)
    along, across = along_and_across(camera, run.load_space().means.numpy())
    seen = _seen(run, camera)
    error, said = _errors(run, true, across)[seen], part["across_sight"].numpy()[seen]
    assert _share_within_two(error, said) > 0.85
    assert (error**2).mean() > 0.04 * (said**2).mean()  # no larger than they must be
    seen[-BALL:] = False  # the next test
    error, said = _errors(run, true, along)[seen], part["along_sight"].numpy()[seen]
    assert _share_within_two(error, said) > 0.85


def test_motion_towards_the_camera_may_be_as_large_as_directions_in_space_allow(trained):
    """95 % of random directions have less than 2 × 1.5 times as much along the sight as across."""
    run, _, camera = trained
    part, found = run.load_part(UNCERTAINTY)[0], run.load_motion()
    along = along_and_across(camera, run.load_space().means.numpy())[0]
    moves = [displacement_at(found, t) for t in range(found.n_timesteps)]
    across2 = np.mean([(d**2).sum(1) - np.einsum("nc,nc->n", d, along) ** 2 for d in moves], 0)
    moving = across2 > 0.5 * across2.max()
    said = part["along_sight"].numpy()[moving]
    assert (said > 1.2 * np.sqrt(across2[moving])).mean() > 0.9
    directions = np.random.default_rng(0).normal(size=(10_000, 3))
    ratio = np.abs(directions[:, 2]) / np.linalg.norm(directions[:, :2], axis=1)
    assert 0.94 < (ratio < 2 * 1.5).mean() < 0.96


def test_motions_drawn_from_the_prior_lie_where_it_says(posed, trained):
    """Motion and fit are then all as they are taken to be, but for noise, of which the covariance has none: 95 %
    within two deviations. Along the sight a draw has a few large coordinates alone, so there are several.
    """
    means, rng, draws = trained[0].load_space().means.numpy(), np.random.default_rng(5), 16
    root, n = stiffness_root(posed.graph), posed.graph.stiffness.shape[0]
    prior = splu((posed.smoothness_weight * (root.T @ root) + posed.ridge * sparse.identity(n)).tocsc())
    noise = np.sqrt(posed.smoothness_weight) * (root.T @ rng.standard_normal((root.shape[0], 3 * draws)))
    noise += np.sqrt(posed.ridge) * rng.standard_normal((n, 3 * draws))
    fields = prior.solve(noise).reshape(n, draws, 3).transpose(1, 0, 2).astype(np.float32)
    motions = np.stack([posed.graph.motion(field) for field in fields])
    motions *= 0.005 / np.sqrt((motions[..., :3] ** 2).mean())
    shown = [view.jvp(motions) for view in posed.views]
    theta = pcg(posed, posed.right_hand_sides(shown), 100, 1e-4).theta
    x = posed.gradient_fields(theta)
    covariance = np.mean([unseen_motion(posed, x, draws, seed)[0] for seed in range(3)], axis=0)
    errors = (posed.fields(theta) - motions)[..., :3]
    for axis in along_and_across(trained[2], means):
        said = np.sqrt(np.einsum("nc,ncd,nd->n", axis, covariance, axis))
        wrong = np.abs(np.einsum("nc,rnc->rn", axis, errors))
        # 1.2 of 24 motions by 64 draws; 16 by 24 of few coordinates scatter by a quarter. Solved to 3e-3 it was 9
        assert 0.6 < np.sqrt((wrong**2).mean() / (said**2).mean()) < 2.2
        assert _share_within_two(wrong, said) > 0.6


@pytest.fixture(scope="module")
def posed(trained):
    run, _, camera = trained
    gaussians = run.load_space()
    problem = Problem.of([view_jacobian(gaussians, camera, (48, 48))], gaussians, MotionConfig(), "cpu")
    return problem.on_cpu(problem.everything, 300.0)


def _fitted(operator, size=0.01):
    """x [1, 4N, 3] of a motion to and fro."""
    motion = np.zeros((1, operator.graph.n_gaussians, DOF), np.float32)
    motion[..., 1] = size
    shown = [view.jvp(motion) for view in operator.views]
    return operator.gradient_fields(pcg(operator, operator.right_hand_sides(shown), 30, 1e-6).theta)


def test_what_it_counts_as_shown_is_what_the_pictures_determine(posed):
    """The trace of A⁻¹ JᵀJ, here by twenty other random pictures."""
    rng, found = np.random.default_rng(9), []
    for _ in range(20):
        white = [rng.standard_normal((1, 48, 48, 3), dtype=np.float32) for _ in posed.views]
        b = posed.right_hand_sides(white)
        found.append(float((b.astype(float) * pcg(posed, b, 100, 3e-3).theta).sum()))
    said = unseen_motion(posed, _fitted(posed), 5)[1]
    assert 3 < said < 48 * 48 * 3
    assert said == pytest.approx(np.mean(found), rel=4 * np.std(found) / np.mean(found) / np.sqrt(2))
