"""Settings of the motion stage: iterations by the number of Gaussians, and what is refused."""

import pytest

from tg4mm.core.errors import Tg4mmError
from tg4mm.fit.motion import MotionConfig
from tg4mm.fit.motion.config import resolved


@pytest.mark.parametrize(("n", "iterations"), [(1, 14), (16_000, 14), (17_000, 21), (10**6, 21)])
def test_where_the_solver_has_patches_it_takes_half_as_many_iterations_again(n, iterations):
    assert resolved(MotionConfig(iterations=14), n) == MotionConfig(iterations=iterations)


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        ({"components": 0}, "components is 0, expected 1 to 100,000"),
        ({"smoothness_weight": -1.0}, "smoothness_weight is -1.0, expected a finite number of at least 0"),
        ({"ridge": 0.0}, "ridge is 0.0, expected a finite number above 0"),
        ({"iterations": 0}, "iterations is 0, expected 1 to 1,000,000"),
        ({"tolerance": 0.0}, "tolerance is 0.0, expected a finite number of at least 1e-06 and below 1"),
        ({"seed": -1}, "seed is -1, expected 0 to"),
        ({"gauss_newton": -1}, "gauss_newton is -1, expected 0 to 1,000"),
        ({"nuisance": "pose"}, "nuisance is pose, expected auto, none, exposure, all"),
    ],
)
def test_settings_out_of_range_are_refused(wrong, match):
    with pytest.raises(Tg4mmError, match=rf"\Asetting motion\.{match}[^\n]*\Z"):
        resolved(MotionConfig(**wrong), 10**6)
