"""How many iterations the motion stage takes: as set, more for many Gaussians, and the run's log tells."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.capture import load_capture, load_images
from tg4mm.core.errors import Tg4mmError
from tg4mm.fit.motion import MotionConfig
from tg4mm.fit.motion import config as of_motion
from tg4mm.fit.motion.config import more_iterations, resolved
from tg4mm.run import Run
from tg4mm.run.stages.motion import train_motion


@pytest.mark.parametrize("n", [1, 9_000, 16_000])
def test_up_to_16000_gaussians_take_what_is_set(n: int) -> None:
    assert resolved(MotionConfig(iterations=9), n) == MotionConfig(iterations=9)


def test_eight_times_as_many_take_four_times_as_many() -> None:
    assert more_iterations(8 * 16_000) == pytest.approx(4)
    assert resolved(MotionConfig(iterations=9), 8 * 16_000) == MotionConfig(iterations=36)


def test_what_is_out_of_range_is_refused_before_it_is_multiplied() -> None:
    with pytest.raises(Tg4mmError, match=r"\Asetting motion.iterations is 0, expected 1 to 1,000,000\Z"):
        resolved(MotionConfig(iterations=0), 10**6)


def test_a_run_of_many_takes_more_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As if they were many: eight times as many as take what is set."""
    gaussians, _ = make_synthetic_dataset(
        tmp_path / "data",
        n_views=6,
        n_timesteps=5,
        size=32,
        freqs=(6.0,),
        amplitude=0.01,
        alphas=(),
        n_test=0,
    )
    capture = load_capture(tmp_path / "data")
    found = []
    for n in (len(gaussians), len(gaussians) // 8):
        monkeypatch.setattr(of_motion, "_AS_CONFIGURED", n)
        run = Run.create(tmp_path / str(n), tmp_path / "data", "modal", {})
        run.save_space(gaussians, {})
        config = MotionConfig(components=1, iterations=2, tolerance=1e-6, appearance=False)
        found.append((train_motion(run, capture, load_images(capture), config), run.log()["motion"]))
    assert [log["iterations"] for _, log in found] == [2, 8]
    few, many = (motion.displacement for motion, _ in found)
    assert abs(few - many).max() > 1e-3 * abs(many).max()
