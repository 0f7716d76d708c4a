"""How uncertain the motion is: noise by two halves, and what is left of the pictures and varies among neighbours."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.capture import Capture, load_capture, load_images
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion import ModalMotion, MotionConfig
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import ViewJacobian, view_jacobian
from tg4mm.fit.motion.observations import PosedFrames, fixed_cameras
from tg4mm.fit.motion.picture_gain import LACKING, PictureGain
from tg4mm.fit.motion.prior.graph import nearest
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.uncertainty import BLOCK, MotionEstimate, residual_displacement
from tg4mm.research.evaluate.displacement import mean_squares
from tg4mm.research.evaluate.subject import uncertainty_figures
from tg4mm.run import UNCERTAINTY, Run
from tg4mm.run.stages.motion import train_motion
from tg4mm.show.maps import blending_weights

SIZE = 4 * BLOCK * 3 + 2  # the last blocks are cut off


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
    ratio = np.average(larger.left(larger.shows((0.01, 0, 0))), weights=weights) / np.average(
        seen.left(seen.shows((0.01, 0, 0))), weights=weights
    )
    assert 0.5 < ratio < 2  # a block is a smaller part of what it shows


def test_it_goes_by_the_square_and_noise_counts_little(seen):
    left = seen.shows((0.01, 0, 0))
    once, twice = seen.left(left), seen.left([2 * pictures for pictures in left])
    np.testing.assert_allclose(twice, 4 * once, rtol=1e-4)
    assert not seen.left([0 * pictures for pictures in left]).any()
    rng = np.random.default_rng(1)
    noise = [
        rng.choice([-1, 1], p.shape).astype(np.float32) * p for p in left
    ]  # of the same power everywhere
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
