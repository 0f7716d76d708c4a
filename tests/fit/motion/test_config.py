"""How many iterations the motion stage takes: as set, more for many Gaussians, and the run's log tells."""

import pytest

from tg4mm.core.errors import Tg4mmError
from tg4mm.fit.motion import MotionConfig
from tg4mm.fit.motion.config import more_iterations, resolved


@pytest.mark.parametrize("n", [1, 9_000, 16_000])
def test_up_to_16000_gaussians_take_what_is_set(n):
    assert resolved(MotionConfig(iterations=9), n) == MotionConfig(iterations=9)


def test_eight_times_as_many_take_four_times_as_many():
    assert more_iterations(8 * 16_000) == pytest.approx(4)
    assert resolved(MotionConfig(iterations=9), 8 * 16_000) == MotionConfig(iterations=36)


def test_what_is_out_of_range_is_refused_before_it_is_multiplied():
    with pytest.raises(Tg4mmError, match=r"\Asetting motion.iterations is 0, expected 1 to 1,000,000\Z"):
        resolved(MotionConfig(iterations=0), 10**6)
