"""What a run says of its uncertainty, beside the true error."""

import numpy as np
import pytest

from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.research.evaluate.subject import uncertainty_figures

N = 400


def motion(displacement: np.ndarray) -> ModalMotion:
    phasors = displacement[None].astype(np.complex64)
    return ModalMotion(np.array([3.0]), phasors, np.zeros_like(phasors), 30.0, 30)


@pytest.fixture
def errors() -> np.ndarray:
    """Peak displacement errors [N, 3] along x, a half normal of 1e-3."""
    out = np.zeros((N, 3))
    out[:, 0] = 1e-3 * np.abs(np.random.default_rng(0).standard_normal(N))
    return out


def test_errors_are_rms_over_time_and_weighted(errors) -> None:
    weights = np.zeros(N)
    weights[:2] = 1, 3
    figures = uncertainty_figures(motion(errors), motion(0 * errors), weights, np.full(N, 2e-3))
    expected = np.sqrt(
        (errors[0, 0] ** 2 + 3 * errors[1, 0] ** 2) / 4 / 2
    )  # of a sinusoid: half its peak squared
    assert figures["error"] == pytest.approx(expected, rel=1e-4)
    assert figures["said"] == pytest.approx(2e-3, rel=1e-6)


def test_the_part_within_twice_what_is_said_counts_by_weight(errors) -> None:
    said = errors[:, 0] / np.sqrt(2)  # what each is off by, rms over time
    weights = np.random.default_rng(1).random(N)
    too_sure = np.arange(N) < 100
    said[too_sure] *= 0.4
    figures = uncertainty_figures(motion(errors), motion(0 * errors), weights, said)
    assert figures["within_two"] == pytest.approx(weights[~too_sure].sum() / weights.sum(), rel=1e-6)


def test_another_number_of_gaussians_is_refused(errors) -> None:
    with pytest.raises(ValueError, match="399"):
        uncertainty_figures(motion(errors), motion(errors), np.ones(N), np.ones(N - 1))
