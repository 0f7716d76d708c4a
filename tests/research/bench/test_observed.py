"""What can be observed: Gaussians whose exact motion is in the pictures, and not those whose pictures show another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.capture import load_capture
from tg4mm.core.magnification import AS_CAPTURED
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.research.bench.observed import AGREES, agreement, looked_at, observed_figures, rms_motion
from tg4mm.research.bench.sets import BenchSet, open_set
from tg4mm.research.evaluate.displacement import displacement_figures
from tg4mm.research.evaluate.subject import Subject
from tg4mm.show.weights import blending_weights

Scene = tuple[Gaussians, ModalMotion, BenchSet]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    root = tmp_path_factory.mktemp("observed") / "sway"
    made = make_synthetic_dataset(
        root, n_views=3, n_timesteps=6, size=48, freqs=(5.0,), amplitude=0.02, alphas=(5,), n_test=3
    )
    return *made, open_set(root, "sway")


def moving(motion: ModalMotion) -> np.ndarray:
    size = rms_motion(motion)
    return size > 0.3 * size.max()


def test_the_true_motion_is_observed(scene: Scene) -> None:
    gaussians, motion, data = scene
    agrees = agreement(gaussians, motion, data)
    assert (agrees[moving(motion)] > 0.9).mean() > 0.9


def test_a_motion_that_the_pictures_do_not_show_is_not(scene: Scene) -> None:
    """As of a mirror: the surface moves, what is seen in it does not, or moves otherwise."""
    gaussians, motion, data = scene
    late = replace(motion, displacement=motion.displacement * 1j)  # a quarter of a period
    assert (agreement(gaussians, late, data)[moving(motion)] >= AGREES).mean() < 0.1


def test_what_stands_still_agrees_with_nothing(scene: Scene) -> None:
    gaussians, motion, data = scene
    still = replace(motion, displacement=0 * motion.displacement)
    assert np.abs(agreement(gaussians, still, data)).max() < 1e-3


@pytest.mark.parametrize(
    ("n", "hz"), [(30, 5.0), (31, 5.0), (61, 5.0), (51, 3.0), (16, 10.0), (90, 0.5), (20, 14.0)]
)
def test_the_timesteps_that_are_looked_at_show_several_phases(n: int, hz: float) -> None:
    times = looked_at(n, 30.0, hz)
    phases = {round(hz * t / 30.0 % 1, 6) for t in times}
    assert len(phases) >= min(3, round(30 / hz))
    assert len(times) == len(set(times)) <= 12
    assert max(times) < n


def test_errors_of_what_is_not_observed_do_not_count(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of what moves is observed, the motion is right there and 40 % too small elsewhere."""
    gaussians, motion, data = scene
    train = load_capture(data.root)
    seen = np.zeros(len(gaussians), bool)
    seen[np.flatnonzero(moving(motion))[::2]] = True
    monkeypatch.setattr("tg4mm.research.bench.observed.agreement", lambda *_: np.where(seen, 1.0, 0.0))
    estimated = replace(motion, displacement=motion.displacement * np.where(seen, 1.0, 0.6)[None, :, None])
    subject = Subject(gaussians, estimated, motion, None, AS_CAPTURED, False, None)
    found = observed_figures(subject, data, train)
    weights = blending_weights(gaussians, train) * (rms_motion(motion) > 0.01 * rms_motion(motion).max())
    assert found["observed_share"] == pytest.approx(weights[seen].sum() / weights.sum(), rel=1e-3)
    assert 0.2 < found["observed_share"] < 0.8
    assert found["displacement_error_observed"] < 0.02
    everything = displacement_figures(estimated, motion, blending_weights(gaussians, train))
    assert everything["relative_error"] > 0.1
