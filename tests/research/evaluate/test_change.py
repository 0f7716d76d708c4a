"""How much of a motion is seen: closure, and the picture's change beside the ceiling's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.capture import Capture, load_capture
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.research.evaluate.scores import Method, change_figures, closure

Scene = tuple[Capture, Gaussians, ModalMotion]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    root = tmp_path_factory.mktemp("change") / "posts_3Hz_0_02"
    made = make_synthetic_dataset(root, n_views=3, n_timesteps=10, size=40, n_test=2, alphas=())
    return load_capture(root, split="test"), *made


def figures(scene: Scene, motion: ModalMotion | None, alpha: float = 0.0) -> dict[str, float | None]:
    capture, gaussians, exact = scene
    return change_figures(gaussians, Method("ours", motion), Method("ceiling", exact), capture, alpha)


def scaled(motion: ModalMotion, by: complex) -> ModalMotion:
    return replace(
        motion,
        displacement=(by * motion.displacement).astype(np.complex64),
        rotation=(by * motion.rotation).astype(np.complex64),
    )


def test_the_exact_motion_changes_the_picture_as_the_ceiling_does(scene: Scene) -> None:
    found = figures(scene, scene[2], alpha=5.0)
    assert found["change_gain"] == pytest.approx(1)
    assert found["change_residual"] == pytest.approx(0, abs=1e-6)


def test_nothing_moving_changes_nothing(scene: Scene) -> None:
    assert figures(scene, None) == {"change_gain": 0.0, "change_residual": 0.0}


def test_a_small_motion_half_as_large_is_half_the_change(scene: Scene) -> None:
    found = figures(scene, scaled(scene[2], 0.5))
    assert found["change_gain"] == pytest.approx(0.5, abs=0.03)
    assert found["change_residual"] < 0.06


def test_a_motion_a_quarter_of_a_period_late_is_beside_it(scene: Scene) -> None:
    found = figures(scene, scaled(scene[2], 1j))
    assert found["change_gain"] == pytest.approx(0, abs=0.15)
    assert found["change_residual"] == pytest.approx(1, abs=0.15)


def test_without_a_change_there_is_nothing_to_compare(scene: Scene) -> None:
    capture, gaussians, exact = scene
    still = Method("ceiling", scaled(exact, 0))
    found = change_figures(gaussians, Method("ours", exact), still, capture, 0.0)
    assert found == {"change_gain": None, "change_residual": None}


def test_closure_is_where_ssim_lies_between_nothing_and_the_ceiling() -> None:
    assert closure(0.95, 0.9, 1.0) == pytest.approx(0.5)
    assert closure(0.85, 0.9, 1.0) == pytest.approx(-0.5)
    assert closure(0.9, 0.9, 0.9) is None
