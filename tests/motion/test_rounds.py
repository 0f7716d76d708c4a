"""Motion of two pixels: what the linear fit misses is found by rounds, and a kill in any of them costs nothing."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.space.test_train import Killed, killed_after
from tests.synthetic import make_synthetic_dataset
from tg4mm.capture import load_capture, load_images
from tg4mm.evaluate.displacement import displacement_figures
from tg4mm.evaluate.truth import exact_motion, load_truth
from tg4mm.evaluate.weights import blending_weights
from tg4mm.gaussians import Gaussians
from tg4mm.motion import ModalMotion, MotionConfig
from tg4mm.motion import train as stage
from tg4mm.motion.animate import animate
from tg4mm.motion.posing import pose
from tg4mm.motion.rounds import linearised
from tg4mm.motion.rounds.moved import MovedProblem
from tg4mm.motion.rounds.rounds import ABOVE_PX, used_components
from tg4mm.motion.solver.device import DeviceProblem
from tg4mm.motion.train import train_motion
from tg4mm.render.image import render_image
from tg4mm.runs import Run
from tg4mm.space import SpaceConfig, rest_views, train_space

CONFIG = MotionConfig(rounds=4)
SHORT = MotionConfig(components=1, neighbours=300.0, iterations=3, rounds=2, tolerance=1e-6)


def _scene(root: Path, amplitude: float, size: int = 64, detail: int = 2) -> Run:
    gaussians, _ = make_synthetic_dataset(
        root / "data",
        n_views=6,
        n_timesteps=5,
        size=size,
        freqs=(6.0,),
        amplitude=amplitude,
        alphas=(),
        n_test=0,
        detail=detail,
    )
    run = Run.create(root / "run", root / "data", "modal", {})
    run.save_space(gaussians, {})
    return run


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Two pixels; the Gaussians are exact."""
    return _scene(tmp_path_factory.mktemp("large"), 0.09)


def _copy(run: Run, path: Path) -> Run:
    shutil.copytree(run.path, path)
    return Run.open(path)


def _trained(run: Run, config: MotionConfig, device: str = "cpu") -> ModalMotion:
    capture = load_capture(run.dataset)
    return train_motion(run, capture, load_images(capture), config, device)


def _error(run: Run) -> float:
    capture = load_capture(run.dataset)
    gaussians, motion = run.load_space(), run.load_motion()
    assert motion is not None
    true = exact_motion(load_truth(run.dataset, capture.fps, capture.n_timesteps), gaussians.means.numpy())
    found = motion.selected(motion.freqs_hz > 0)
    return displacement_figures(found, true, blending_weights(gaussians, capture))["relative_error"]


@pytest.fixture(scope="module")
def found(large: Run, tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Run]:
    """The linear fit alone, and with rounds."""
    root = tmp_path_factory.mktemp("found")
    runs = _copy(large, root / "linear"), _copy(large, root / "rounds")
    for run, most in zip(runs, (0, CONFIG.rounds), strict=True):
        _trained(run, replace(CONFIG, rounds=most))
    return runs


@pytest.mark.parametrize(
    ("is_noise", "used"),
    [
        ([0, 1, 1], [0, 1, 2]),
        ([0] + 11 * [1], list(range(8))),  # eight in all
        ([0, 1, 0] + 9 * [1], list(range(8))),
        (6 * [0] + 9 * [1], list(range(13))),  # as many others and one
    ],
)
def test_rounds_fit_some_of_the_weak_components_too(is_noise: list[int], used: list[int]) -> None:
    assert used_components(np.array(is_noise, bool)).tolist() == used


def test_two_pixels_are_found_by_rounds(found: tuple[Run, Run]) -> None:
    """.18 after four rounds, .52 without."""
    linear, rounds_ = (_error(run) for run in found)
    assert linear > 0.4
    assert rounds_ < 0.2


def test_every_round_leaves_less_of_the_pictures(found: tuple[Run, Run]) -> None:
    log = found[1].log()["motion"]
    assert log["pixels_moved"] > ABOVE_PX
    assert len(log["misfit_of_rounds"]) == log["rounds"] + 1
    assert (np.diff(log["misfit_of_rounds"]) < 0).all()
    assert log["misfit_of_rounds"][-1] < 0.1 * log["misfit_of_rounds"][0]
    assert found[0].log()["motion"]["rounds"] == 0


def test_no_checkpoint_stays(found: tuple[Run, Run]) -> None:
    for run in found:
        assert not list(run.path.glob("checkpoint_*"))


def _pictures_error(run: Run, gaussians: Gaussians) -> float:
    """Mean squared error of the captured pictures, the Gaussians moved as the truth does."""
    capture = load_capture(run.dataset)
    images = load_images(capture)
    truth = load_truth(run.dataset, capture.fps, capture.n_timesteps)
    motion = exact_motion(truth, gaussians.means.numpy())
    total = 0.0
    for i in range(len(capture)):
        there = animate(gaussians, motion, int(capture.timesteps[i]))
        size = (capture.width, capture.height)
        shown = render_image(there, capture.viewmats[i], capture.Ks[i], *size)
        total += float(((shown - images.rgb(i, background=(1, 1, 1))) ** 2).mean())
    return total / len(capture)


def test_a_scene_blurred_by_its_motion_is_sharp_again(large: Run, tmp_path: Path) -> None:
    """Fitted to the mean over time, as the space stage does, it is far from what one timestep shows."""
    capture = load_capture(large.dataset)
    run = Run.create(tmp_path / "run", large.dataset, "modal", {})
    train_space(
        run,
        rest_views(capture, load_images(capture)),
        capture.points,
        SpaceConfig(iterations=400, sh_degree=0),
    )
    blurred = run.load_space()
    _trained(run, CONFIG)
    sharp = run.load_space()
    assert len(sharp) == len(blurred)
    assert _pictures_error(run, sharp) < 0.6 * _pictures_error(run, blurred)


def test_small_motion_is_left_as_it_was(tmp_path: Path) -> None:
    """To the last bit, and the scene at rest too."""
    small = _scene(tmp_path / "small", 0.005, size=32, detail=1)
    runs = [_copy(small, tmp_path / f"{k}") for k in range(2)]
    motions = [_trained(run, replace(CONFIG, rounds=k)) for k, run in enumerate(runs)]
    assert _equal(*motions)
    assert 0 < runs[1].log()["motion"]["pixels_moved"] < ABOVE_PX
    assert (runs[0].path / "space.safetensors").read_bytes() == (
        runs[1].path / "space.safetensors"
    ).read_bytes()


def _equal(a: ModalMotion, b: ModalMotion) -> bool:
    return all(np.array_equal(getattr(a, n), getattr(b, n)) for n in ("freqs_hz", "displacement", "rotation"))


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Run, ModalMotion]:
    """A small scene of large motion; a run of it that nobody killed, and what it found."""
    root = tmp_path_factory.mktemp("quick")
    scene = _scene(root, 0.2, size=32, detail=1)
    whole = _copy(scene, root / "whole")
    return scene, whole, _trained(whole, SHORT)


def test_the_same_settings_give_the_same_bits(quick: tuple[Run, Run, ModalMotion], tmp_path: Path) -> None:
    scene, whole, expected = quick
    again = _copy(scene, tmp_path / "again")
    assert _equal(_trained(again, SHORT), expected)
    assert whole.log()["motion"]["rounds"] >= 1
    assert torch.equal(again.load_space().means, whole.load_space().means)
    assert not torch.equal(again.load_space().means, scene.load_space().means)


def _kill(run: Run, at: int, which: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """At an update of one progress; a checkpoint at each before."""
    progress = stage.progress

    def killed(label: str, *args: object, **more: object) -> object:
        return (killed_after(at) if label == which else progress)(label, *args, **more)

    with monkeypatch.context() as patch:
        # the linear fit's own checkpoints would hide that rounds begin with one
        patch.setattr(stage, "CHECKPOINT_EVERY_S", -1.0 if at > 1 else 1e9)
        patch.setattr(stage, "progress", killed)
        with pytest.raises(Killed):
            _trained(run, SHORT)


@pytest.mark.parametrize("killed_at", [2, 4, 5, 8, 9, 20, 256, 257, 258])
def test_killed_in_a_round_it_ends_as_if_it_had_not_been(
    killed_at: int, quick: tuple[Run, Run, ModalMotion], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each half three iterations, then 250 of the scene at rest; a checkpoint at each."""
    scene, whole, expected = quick
    run = _copy(scene, tmp_path / "run")
    _kill(run, killed_at, "motion rounds", monkeypatch)
    assert not run.has_motion
    assert run.load_checkpoint("motion") is not None
    assert _equal(_trained(run, SHORT), expected)
    for name in ("means", "quats", "scales", "opacities", "sh"):
        assert torch.equal(getattr(run.load_space(), name), getattr(whole.load_space(), name))
    for name in ("pixels_moved", "rounds", "misfit_of_rounds", "neighbours"):
        assert run.log()["motion"][name] == whole.log()["motion"][name]


@pytest.mark.parametrize("version", [None, 3])
def test_rounds_of_another_linear_fit_are_not_taken_up(
    version: int | None, quick: tuple[Run, Run, ModalMotion], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its checkpoint was deleted, or is of another version."""
    scene, _, expected = quick
    run = _copy(scene, tmp_path / "run")
    _kill(run, 9, "motion rounds", monkeypatch)
    (tensors, state), fit = (run.load_checkpoint(name) for name in ("rounds", "motion"))
    run.save_checkpoint("rounds", tensors | {"fields": 0.5 * tensors["fields"]}, state)
    run.drop_checkpoint("motion")
    if version:
        run.save_checkpoint("motion", fit[0], fit[1] | {"version": version})
    assert _equal(_trained(run, SHORT), expected)


def test_the_linear_fit_is_kept_beside_rounds_of_another_version(
    quick: tuple[Run, Run, ModalMotion], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = _copy(quick[0], tmp_path / "run")
    _kill(run, 2, "motion stage", monkeypatch)
    run.save_checkpoint("rounds", {"what": torch.zeros(1)}, {"version": 0})
    assert run.load_checkpoint("motion")[1]["component"] == 0
    _kill(run, 1, "motion rounds", monkeypatch)
    assert run.load_checkpoint("motion")[1]["component"] == 2  # one of each half


def test_killed_between_its_two_results_it_ends_the_same(
    quick: tuple[Run, Run, ModalMotion], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The scene at rest is already the new one, the motion not there yet."""
    scene, whole, expected = quick
    run = _copy(scene, tmp_path / "run")

    def killed(self: Run, *_: object) -> None:
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(Run, "save_motion", killed)
        with pytest.raises(Killed):
            _trained(run, SHORT)
    assert not torch.equal(run.load_space().means, scene.load_space().means)
    assert _equal(_trained(run, SHORT), expected)
    assert torch.equal(run.load_space().means, whole.load_space().means)


def test_a_checkpoint_of_another_version_is_not_taken_up(
    quick: tuple[Run, Run, ModalMotion], tmp_path: Path
) -> None:
    scene, _, expected = quick
    run = _copy(scene, tmp_path / "run")
    run.save_checkpoint("rounds", {"what": torch.zeros(1)}, {"version": 0})
    assert _equal(_trained(run, SHORT), expected)


def test_what_only_gets_worse_is_not_taken(
    quick: tuple[Run, Run, ModalMotion], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A round whose motion points away leaves everything as the linear fit had it."""
    scene = quick[0]
    runs = [_copy(scene, tmp_path / name) for name in ("linear", "wrong")]
    expected = _trained(runs[0], replace(SHORT, rounds=0))
    fields = MovedProblem.fields
    monkeypatch.setattr(MovedProblem, "fields", lambda self, theta: -3 * fields(self, theta))
    assert _equal(_trained(runs[1], SHORT), expected)
    assert runs[1].log()["motion"]["rounds"] == 0
    assert torch.equal(runs[1].load_space().means, scene.load_space().means)


def test_what_is_not_taken_leaves_the_linear_fits_own_components(
    quick: tuple[Run, Run, ModalMotion], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rounds fit more of them than the linear fit, which light goes with, did."""
    runs = [_copy(quick[0], tmp_path / name) for name in ("linear", "wrong")]
    several = replace(SHORT, components=4)
    told = lambda problem, parts, images, at_once: np.arange(images.shape[1]) > 0  # noqa: E731
    monkeypatch.setattr(pose, "noise_components", told)
    expected = _trained(runs[0], replace(several, rounds=0))
    fields = MovedProblem.fields
    monkeypatch.setattr(MovedProblem, "fields", lambda self, theta: -3 * fields(self, theta))
    found = _trained(runs[1], several)
    assert _equal(found, expected)
    figures = [run.log()["motion"] for run in runs]
    assert [f["components"] for f in figures] == [1, 1]
    assert [f["rounds"] for f in figures] == [0, 0]
    assert figures[0]["components_of_noise"] > 0
    assert figures[0].get("gain_of_light") == figures[1].get("gain_of_light")


def test_on_a_device_it_finds_the_same(
    quick: tuple[Run, Run, ModalMotion], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What CUDA runs, on the CPU's tensors; one round, since fitting the scene at rest forks from the last digits."""
    runs = [_copy(quick[0], tmp_path / name) for name in ("kernels", "device")]
    expected = _trained(runs[0], replace(SHORT, rounds=1))
    monkeypatch.setattr(linearised, "on_device", lambda problem, device: DeviceProblem(problem, "cpu"))
    found = _trained(runs[1], replace(SHORT, rounds=1))
    scale = np.abs(expected.displacement).max()
    np.testing.assert_allclose(found.displacement, expected.displacement, atol=2e-3 * scale)
    assert np.abs(found.displacement - expected.displacement).max() > 0  # it was another way
