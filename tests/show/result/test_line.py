"""Vibrations take frequency, damping and phasors from the motion's own series."""

from __future__ import annotations

import numpy as np
import pytest

from tg4mm.core.phasors import series_modes
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.show.result.line import line_near, phasors_at, why_no_damping

FPS, N = 30.0, 120
T = np.arange(N) / FPS


def ringing(hz: float, decay: float) -> np.ndarray:
    return np.exp(-decay * T) * np.cos(2 * np.pi * hz * T)


def test_a_bin_beside_what_rings_down_becomes_its_line() -> None:
    rng = np.random.default_rng(0)
    line = line_near(ringing(5.13, 1.0) + 0.01 * rng.normal(size=N), FPS, 5.0, [9.0], 0.0)
    assert line is not None
    assert abs(line.hz - 5.13) < 3 * line.hz_deviation < 0.02
    assert line.damping == pytest.approx(1.0 / np.hypot(1.0, 2 * np.pi * 5.13), rel=0.05)
    assert why_no_damping(line) == ""


def test_noise_that_is_known_from_elsewhere_is_in_the_deviation() -> None:
    clean = line_near(ringing(5.2, 0.0), FPS, 5.2, [], 0.0)
    known = line_near(ringing(5.2, 0.0), FPS, 5.2, [], 0.1)
    assert clean is not None
    assert known is not None
    assert clean.hz_deviation < 1e-5
    bound = np.sqrt(6) * 0.1 / np.sqrt(2) / (np.pi * np.sqrt(N) * N / FPS)
    assert known.hz_deviation == pytest.approx(bound, rel=0.1)


@pytest.mark.parametrize(
    ("size", "decay", "said"),
    [(1.0, 0.0, "stays as strong"), (1.0, -1.0, "grows"), (0.04, 0.0, "noise hides")],
)
def test_what_is_said_of_its_strength_is_tested(size: float, decay: float, said: str) -> None:
    rng = np.random.default_rng(3)
    line = line_near(size * ringing(5.2, decay) + 0.05 * rng.normal(size=N), FPS, 5.2, [], 0.0)
    assert said in why_no_damping(line)


def test_a_record_too_short_tells_nothing() -> None:
    assert line_near(ringing(5.0, 0.0)[:8], FPS, 5.0, [], 0.0) is None
    assert why_no_damping(None) == "the record is too short"


def test_phasors_are_those_of_the_line_in_all_bins_together() -> None:
    shape = np.array([[1.0, 0.0, 0.5], [0.0, 2.0, 0.0]])
    series = ringing(5.13, 1.0)[:, None, None] * shape
    hz, values = series_modes(series, FPS)
    motion = ModalMotion(hz, values, np.zeros_like(values), FPS, N)
    line = line_near(ringing(5.13, 1.0), FPS, 5.13, [], 0.0)
    assert line is not None
    np.testing.assert_allclose(phasors_at(motion, line), shape, atol=0.01)
    between = np.arange(N) % 4 != 0
    np.testing.assert_allclose(phasors_at(motion, line, between), shape, atol=0.01)
