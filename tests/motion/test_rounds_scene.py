"""What rounds do to the scene at rest, and what they must not: whose cameras, whose Gaussians, work done once."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.synthetic import make_synthetic_dataset
from tg4mm.capture import Capture, load_capture, load_images
from tg4mm.gaussians import Gaussians
from tg4mm.motion import MotionConfig
from tg4mm.motion.pictures.video import fixed_cameras
from tg4mm.motion.posing.pose import Problems
from tg4mm.motion.rounds import evidence, polish
from tg4mm.motion.rounds.evidence import Evidence
from tg4mm.motion.rounds.polish import Polish, Seen
from tg4mm.motion.rounds.rounds import Rounds
from tg4mm.motion.train import train_motion
from tg4mm.runs import Run

SHORT = MotionConfig(components=1, neighbours=300.0, iterations=6, rounds=1, tolerance=1e-6)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Gaussians]:
    """Seven cameras; the Gaussians are where they should be, but blurred."""
    root = tmp_path_factory.mktemp("seven") / "data"
    gaussians, _ = make_synthetic_dataset(
        root, n_views=7, n_timesteps=5, size=32, freqs=(6.0,), amplitude=0.2, alphas=(), n_test=0
    )
    return root, replace(gaussians, scales=1.5 * gaussians.scales)


def _trained(
    data: tuple[Path, Gaussians], path: Path, config: MotionConfig = SHORT, wandering: int | None = None
) -> Run:
    """`wandering`: a camera that stays nowhere."""
    capture = load_capture(data[0])
    run = Run.create(path, data[0], "modal", {})
    run.save_space(data[1], {})
    train_motion(
        run, capture if wandering is None else _without(capture, wandering), load_images(capture), config
    )
    return run


def _without(capture: Capture, camera: int) -> Capture:
    ids = capture.camera_ids.copy()
    rows = np.flatnonzero(ids == camera)
    ids[rows] = ids.max() + np.arange(len(rows))
    return replace(capture, camera_ids=ids)


def _is_as_before(run: Run, gaussians: Gaussians) -> bool:
    found = run.load_space()
    names = ("means", "quats", "scales", "opacities", "sh")
    return all(torch.equal(getattr(found, n), getattr(gaussians, n)) for n in names)


def test_fixed_cameras_alone_sharpen_the_scene(data, tmp_path: Path) -> None:
    assert not _is_as_before(_trained(data, tmp_path / "run"), data[1])


def test_a_scene_that_other_cameras_saw_stays(data, tmp_path: Path) -> None:
    """Six fixed cameras and one that wanders: the motion is found in rounds, the scene is not theirs alone."""
    run = _trained(data, tmp_path / "run", wandering=6)
    log = run.log()["motion"]
    assert (log["views"], log["rounds"]) == (6, 1)
    assert _is_as_before(run, data[1])


@pytest.mark.parametrize("brightened", [0.0, 0.5])
def test_gaussians_that_show_the_pictures_worse_are_not_taken(
    brightened: float, data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What changes is off; or sharper as it ought to be, but all of it too bright at all times."""
    gaussians, real = data[1], Polish.gaussians

    def worse(self: Polish) -> Gaussians:
        g = real(self)
        moved = g.means + (0.0 if brightened else 0.2)
        return replace(g, means=moved, sh=g.sh + brightened)

    monkeypatch.setattr(Polish, "gaussians", worse)
    run = _trained(data, tmp_path / "run")
    assert run.log()["motion"]["rounds"] == 1
    assert np.diff(run.log()["motion"]["misfit_of_rounds"])[0] < 0
    assert _is_as_before(run, gaussians)


def test_states_count_by_how_long_they_last(data, monkeypatch: pytest.MonkeyPatch) -> None:
    root, gaussians = data
    cameras = fixed_cameras(load_capture(root))[:2]
    motions = np.zeros((2, len(gaussians), 6), np.float32)
    motions[1, :, 0] = 0.1
    seen = Seen(cameras, np.zeros((2, 2, 32, 32, 3), np.float32), motions, np.array([0, 0, 1, 0]))
    drawn, real = [], polish.at_state

    def recorded(g: Gaussians, motion: torch.Tensor) -> Gaussians:
        drawn.append(int(motion[0, 0] > 0))
        return real(g, motion)

    monkeypatch.setattr(polish, "at_state", recorded)
    begun = Polish.begun(gaussians, 8, (32, 32), 0, "cpu")
    for _ in range(8):
        begun.step(seen)
    assert (drawn.count(0), drawn.count(1)) == (6, 2)


def _counted(function: Callable, calls: list[str]) -> Callable:
    def counted(*args: object, **more: object) -> object:
        calls.append(function.__name__)
        return function(*args, **more)

    return counted


def test_nothing_is_rendered_or_posed_twice(data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A round without polishing renders at first, to choose the weight, to linearise, and what it found; in the end
    what is left is rendered once, to say how sure the motion is."""
    calls: list[str] = []
    monkeypatch.setattr(evidence, "rendered", _counted(evidence.rendered, calls))
    monkeypatch.setattr(Problems, "of", _counted(Problems.of, calls))
    run = _trained(data, tmp_path / "run", replace(SHORT, neighbours=0.0), wandering=6)
    assert run.log()["motion"]["rounds"] == 1
    assert calls.count("rendered") == 5
    assert calls.count("of") == 2  # one of them before the linear fit


def test_what_uncertainty_does_not_ask_for_is_not_made(
    data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []
    monkeypatch.setattr(Rounds, "_at_rest", _counted(Rounds._at_rest, calls))
    run = _trained(data, tmp_path / "run", replace(SHORT, halves=False))
    assert run.log()["motion"]["rounds"] == 1
    assert not calls


def test_one_knots_component_images_are_held_at_a_time(
    data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[weakref.ref] = []
    alive: list[int] = []
    real = Evidence.target

    def watched(self: Evidence, *args: np.ndarray) -> np.ndarray:
        alive.append(sum(r() is not None for r in made))
        target = real(self, *args)
        made.append(weakref.ref(target))
        return target

    monkeypatch.setattr(Evidence, "target", watched)
    _trained(data, tmp_path / "run")
    assert len(made) == 4  # three knots, and what is left in the end
    assert not any(alive)
