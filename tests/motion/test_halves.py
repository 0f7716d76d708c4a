"""What two halves of the cameras agree on: noise shrinks, motion stays, and the deviation is that of the noise."""

from __future__ import annotations

import shutil
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.synthetic import make_synthetic_dataset
from tg4mm.capture import ImageStack, load_capture, load_images
from tg4mm.motion import MotionConfig
from tg4mm.motion.certainty.halves import LEAST, agreed_gain, deviation, halves
from tg4mm.motion.prior.graph import nearest
from tg4mm.motion.train import train_motion
from tg4mm.runs import UNCERTAINTY, Run

SIGMA = 0.3
CONFIG = MotionConfig(components=1, iterations=15, tolerance=1e-3)


@pytest.mark.parametrize("n", [0, 1, LEAST - 1])
def test_few_cameras_are_not_halved(n: int) -> None:
    assert halves(n) == []


@pytest.mark.parametrize("n", [LEAST, LEAST + 1, 30])
def test_every_camera_is_in_one_half(n: int) -> None:
    a, b = halves(n)
    assert sorted([*a, *b]) == list(range(n))
    assert abs(len(a) - len(b)) <= 1
    assert (np.diff(a) == 2).all()  # neighbours on the orbit part


def fields(seed: int = 0, n: int = 3000) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(truth, whole, a, b, means): one component moves, one is noise alone; `whole` is the halves' mean."""
    rng = np.random.default_rng(seed)
    means = rng.random((n, 3))
    truth = np.zeros((2, n, 3))
    truth[0] = (0.3, -0.3, 0.2)
    a, b = (truth + SIGMA * rng.normal(size=truth.shape) for _ in range(2))
    return truth, (a + b) / 2, a, b, means


def test_motion_is_kept_and_a_component_of_noise_is_not() -> None:
    truth, whole, a, b, _ = fields()
    gain = agreed_gain(whole, a, b)
    assert gain[1] < 0.1
    shrunk = whole * gain[:, None, None]
    assert np.linalg.norm(shrunk - truth) < 0.6 * np.linalg.norm(whole - truth)


def test_the_gain_is_wieners() -> None:
    """S / (S + N) with the power of the motion and of the noise in `whole`, which no other gain betters."""
    truth, whole, a, b, _ = fields(n=6000)
    signal, noise = 0.22, 3 * SIGMA**2 / 2
    gain = agreed_gain(whole, a, b)[0]
    assert gain == pytest.approx(signal / (signal + noise), abs=0.01)
    error = {g: np.linalg.norm(g * whole[0] - truth[0]) for g in (gain - 0.05, gain, gain + 0.05)}
    assert min(error, key=lambda g: error[g]) == gain


def test_halves_that_contradict_each_other_give_nothing() -> None:
    a = np.random.default_rng(0).normal(size=(1, 50, 3))
    assert agreed_gain(0.1 * a, a, -a)[0] == 0


def test_the_deviation_is_that_of_the_noise_in_the_whole() -> None:
    """Here three times as strong on one side as on the other."""
    truth, _, a, b, means = fields()
    uneven = np.where(means[:, :1] < 0.5, 1.0, 3.0)
    a, b = (truth + (x - truth) * uneven for x in (a, b))
    found = deviation(a, b, nearest(means)[1])
    for side in (means[:, 0] < 0.4, means[:, 0] > 0.6):
        error = ((a + b) / 2 - truth)[:, side]
        expected = np.sqrt((error**2).sum((0, 2)).mean())
        np.testing.assert_allclose(np.sqrt((found[side] ** 2).mean()), expected, rtol=0.05)


def test_what_the_halves_agree_on_exactly_stays_as_it_is() -> None:
    truth, _, _, _, means = fields(n=500)
    np.testing.assert_allclose(agreed_gain(truth, truth, truth), [1, 0], rtol=1e-6)
    assert not deviation(truth, truth, nearest(means)[1]).any()


def test_nothing_moves_nothing_is_divided_by_zero() -> None:
    zero, means = np.zeros((1, 5, 3), np.float32), np.random.default_rng(0).random((5, 3))
    assert not agreed_gain(zero, zero, zero).any()
    assert not deviation(zero, zero, nearest(means)[1]).any()


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Six cameras; the Gaussians are exact."""
    root = tmp_path_factory.mktemp("halves")
    gaussians, _ = make_synthetic_dataset(
        root / "data", n_views=LEAST, n_timesteps=5, size=32, freqs=(6.0,), alphas=(), n_test=0
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
    assert logs[1]["gain_of_components"][0] < logs[0]["gain_of_components"][0] <= 1


def test_without_halves_there_is_none(scene: Run, tmp_path: Path) -> None:
    images = load_images(load_capture(scene.dataset))
    run = _trained(scene, tmp_path / "run", images, replace(CONFIG, halves=False))
    assert not run.has_part(UNCERTAINTY)
    assert "noise_to_motion" not in run.log()["motion"]


def test_one_camera_is_warned_of_with_a_number(tmp_path: Path) -> None:
    gaussians, _ = make_synthetic_dataset(
        tmp_path / "data", n_views=1, n_timesteps=5, size=32, freqs=(6.0,), alphas=(), n_test=0
    )
    run = Run.create(tmp_path / "run", tmp_path / "data", "modal", {})
    run.save_space(gaussians, {})
    capture = load_capture(run.dataset)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        train_motion(run, capture, load_images(capture), CONFIG)
    said = [str(w.message) for w in caught if "line of sight" in str(w.message)]
    assert len(said) == 1
    ratio = float(said[0].split("pictures ")[1].split(" times")[0])
    assert 0 < ratio < 0.5
