"""How uncertain the motion is: noise by two halves, and what is left of the pictures and varies among neighbours."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.capture import Capture, ImageStack, load_capture, load_images
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion import ModalMotion, MotionConfig
from tg4mm.fit.motion import uncertainty as module
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import ViewJacobian, blend_sum, view_jacobian
from tg4mm.fit.motion.observations import PosedFrames, fixed_cameras
from tg4mm.fit.motion.prior.graph import nearest
from tg4mm.fit.motion.uncertainty import BLOCK, MotionEstimate, local_variance, residual_displacement
from tg4mm.research.evaluate.displacement import mean_squares
from tg4mm.research.evaluate.subject import uncertainty_figures
from tg4mm.run import UNCERTAINTY, Run
from tg4mm.run.stages.motion import train_motion
from tg4mm.show.weights import blending_weights

SIZE = 4 * BLOCK * 3 + 2  # the last blocks are cut off


@dataclass(frozen=True)
class Seen:
    capture: Capture
    gaussians: Gaussians
    motion: ModalMotion
    cameras: list[PosedFrames]
    views: list[ViewJacobian]

    @property
    def knn(self) -> np.ndarray:
        return nearest(self.gaussians.means.numpy())[1]

    def left(self, left: list[np.ndarray]) -> np.ndarray:
        nothing = np.zeros((2, 0, len(self.gaussians), 6), np.float32)
        return residual_displacement(
            MotionEstimate(nothing, nothing[0], self.gaussians, self.knn, self.views, self.cameras, left)
        )

    def shows(self, displacement: tuple[float, float, float]) -> list[np.ndarray]:
        """[1, H, W, 3] of each view: what it changes if everything moves."""
        fields = np.zeros((1, len(self.gaussians), DOF), np.float32)
        fields[..., :3] = displacement
        return [view.jvp(fields) for view in self.views]

    def weights(self) -> np.ndarray:
        return blending_weights(self.gaussians, self.capture)


def _views(gaussians: Gaussians, cameras: list[PosedFrames], size: int) -> list[ViewJacobian]:
    return [view_jacobian(gaussians, camera, (size, size)) for camera in cameras]


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Seen:
    """Ten cameras; the Gaussians are exact. The post sways, the ball moves, the floor stands still."""
    root = tmp_path_factory.mktemp("uncertainty") / "data"
    gaussians, motion = make_synthetic_dataset(
        root, n_views=10, n_timesteps=5, size=SIZE, freqs=(6.0,), amplitude=0.01, alphas=(), n_test=0
    )
    capture = load_capture(root)
    cameras = fixed_cameras(capture)
    return Seen(capture, gaussians, motion, cameras, _views(gaussians, cameras, SIZE))


def test_a_picture_is_blended_by_what_the_gaussians_cover(seen: Seen) -> None:
    """All Gaussians together by 1 − transmittance, each by its weight in the renderer's own gradient."""
    picture = np.random.default_rng(0).random((SIZE, SIZE, 3)).astype(np.float32)
    for view in seen.views[:3]:
        covered = ((1 - view.transmittance)[..., None] * picture).sum((0, 1))
        np.testing.assert_allclose(blend_sum(view, picture).sum(0), covered, rtol=1e-4)
    total = sum(blend_sum(view, np.ones_like(picture))[:, 0].astype(np.float64) for view in seen.views)
    weights = seen.weights() / seen.capture.n_timesteps
    assert np.abs(total - weights).sum() < 0.02 * weights.sum()  # which cuts off at 1/255


def test_what_is_left_of_a_shift_is_a_part_of_it_on_each_scale(seen: Seen) -> None:
    """Of a scene that moves as a whole and whose motion was missed, in any direction and in pictures of any size."""
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


def test_on_a_ramp_it_is_what_is_left_over_its_slope(seen: Seen) -> None:
    """r on a slope of g per pixel is r / g pixels, z / f of a unit each."""
    view, camera, g, r = seen.views[0], seen.cameras[0], 0.02, 0.003
    image = view.image.copy()
    image[..., :3] = g * np.arange(SIZE)[:, None] - view.transmittance[..., None]
    one = replace(seen, cameras=[camera], views=[replace(view, image=image)])
    found = one.left([np.full((1, SIZE, SIZE, 3), r, np.float32)])
    depth = seen.gaussians.means.numpy() @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
    near = np.ptp(depth[seen.knn], axis=1) < 0.1 * depth  # neighbours are about as far away
    shown = blend_sum(view, np.ones((SIZE, SIZE, 3), np.float32))[:, 0] > 0
    assert (near & shown).sum() > 100
    expected = (r / g * depth / camera.K[0, 0]) ** 2
    np.testing.assert_allclose(found[near & shown], expected[near & shown], rtol=0.15)


def test_it_goes_by_the_square_and_noise_counts_little(seen: Seen) -> None:
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


def test_what_no_camera_sees_counts_as_the_whole_scene(seen: Seen) -> None:
    means = seen.gaussians.means.clone()
    means[:40, 2] -= 100.0  # far below, all around each other
    away = replace(seen.gaussians, means=means)
    hidden = replace(seen, gaussians=away, views=_views(away, seen.cameras, SIZE))
    found = hidden.left(hidden.shows((0.01, 0, 0)))
    assert np.isfinite(found).all()
    assert found[:40].std() == 0
    assert found[40:].min() < found[0] < found[40:].max()


def test_blocks_at_the_border_are_means_of_the_pixels_they_have() -> None:
    even = np.ones((2, SIZE, SIZE + 1, 3), np.float32)
    np.testing.assert_allclose(module._of_blocks(even), 6.0)
    rng = np.random.default_rng(3)
    picture = rng.normal(size=(1, SIZE, SIZE, 3)).astype(np.float32)
    corner = picture[0, -(SIZE % BLOCK) :, -(SIZE % BLOCK) :].mean((0, 1))
    found = module._of_blocks(picture)
    assert found.shape == (SIZE, SIZE)
    assert found[-1, -1] == pytest.approx((corner**2).sum(), rel=1e-5)
    assert found[0, 0] == pytest.approx((picture[0, :BLOCK, :BLOCK].mean((0, 1)) ** 2).sum(), rel=1e-5)


def test_what_is_flat_is_no_reason_for_uncertainty_without_bounds(seen: Seen) -> None:
    """Pictures of one colour but for twelve columns, and noise: 0.04 units at most, not 1e17. The scene is 2 wide."""
    views = []
    for view in seen.views:
        image = view.image.copy()
        image[:, 12:, :3] = 1 - view.transmittance[:, 12:, None]
        views.append(replace(view, image=image))
    rng = np.random.default_rng(4)
    noise = [0.01 * rng.normal(size=(1, SIZE, SIZE, 3)).astype(np.float32) for _ in views]
    found = np.sqrt(replace(seen, views=views).left(noise))
    assert 0.01 < found.max() < 0.1
    assert found.min() > 1e-4


def test_variation_is_the_variance_among_neighbours(seen: Seen) -> None:
    rng = np.random.default_rng(2)
    means = rng.random((300, 3))
    knn = nearest(means)[1]
    shapes = rng.normal(size=(2, 300, 3)).astype(np.float32) + 5
    expected = shapes.astype(np.float64)[:, knn].var(2).sum((0, 2))
    np.testing.assert_allclose(local_variance(shapes, knn), expected, rtol=1e-6)
    assert local_variance(np.full((2, 300, 3), 7.0, np.float32), knn).max() < 1e-9


def test_a_run_knows_how_far_off_it_is(seen: Seen, tmp_path: Path) -> None:
    """Within two deviations for most of what is seen, where noise alone says much too little, and not far too much."""
    run = Run.create(tmp_path / "run", seen.capture.root, "modal", {})
    run.save_space(seen.gaussians, {})
    train_motion(run, seen.capture, load_images(seen.capture), MotionConfig())
    found = run.load_motion()
    assert found is not None
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


CONFIG = MotionConfig(components=1, iterations=15, tolerance=1e-3)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Six cameras; the Gaussians are exact."""
    root = tmp_path_factory.mktemp("halves")
    gaussians, _ = make_synthetic_dataset(
        root / "data", n_views=6, n_timesteps=5, size=32, freqs=(6.0,), alphas=(), n_test=0
    )
    run = Run.create(root / "run", root / "data", "modal", {})
    run.save_space(gaussians, {})
    return run


def _noisy(images: ImageStack) -> ImageStack:
    noise = np.random.default_rng(0).normal(0, 25, images.data.shape)
    data = np.clip(images.data + noise, 0, 255).astype(images.data.dtype)
    data[..., 3:] = images.data[..., 3:]
    return replace(images, data=data)


def _trained(scene: Run, path: Path, images: ImageStack, config: MotionConfig) -> Run:
    shutil.copytree(scene.path, path)
    run = Run.open(path)
    train_motion(run, load_capture(run.dataset), images, config)
    return run


def test_a_run_gets_its_uncertainty_which_grows_with_noise(scene: Run, tmp_path: Path) -> None:
    images = load_images(load_capture(scene.dataset))
    runs = [
        _trained(scene, tmp_path / k, i, CONFIG) for k, i in (("clean", images), ("noisy", _noisy(images)))
    ]
    clean, noisy = (run.load_part(UNCERTAINTY)[0] for run in runs)
    for name, times in (("noise", 1.5), ("displacement", 1.0)):
        a, b = (part[name].numpy() for part in (clean, noisy))
        assert a.shape == (len(scene.load_space()),)
        assert np.isfinite(a).all()
        assert np.linalg.norm(b) > times * np.linalg.norm(a)
    assert (noisy["displacement"] > noisy["noise"]).all()
    logs = [run.log()["motion"] for run in runs]
    assert logs[1]["noise_to_motion"] > logs[0]["noise_to_motion"]
    assert logs[1]["reliability"][0] < logs[0]["reliability"][0] <= 1


def test_without_folds_there_is_none(scene: Run, tmp_path: Path) -> None:
    images = load_images(load_capture(scene.dataset))
    run = _trained(scene, tmp_path / "run", images, replace(CONFIG, split_half=False))
    assert not run.has_part(UNCERTAINTY)
    assert "noise_to_motion" not in run.log()["motion"]
