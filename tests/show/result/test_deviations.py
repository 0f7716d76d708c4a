"""Errors of the displacement are spread over modes."""

from __future__ import annotations

import numpy as np

from tests.fit.motion.scenes import of_amplitudes
from tg4mm.show.result.line import mode_deviations


def test_a_single_mode_takes_the_whole_error_and_a_weak_one_its_share() -> None:
    """Amplitude: √2 times the rms over time."""
    deviation, noise = np.full(50, 0.5), np.full(50, 0.3)
    alone = mode_deviations(of_amplitudes([2.0], [5.0]), deviation, noise)
    np.testing.assert_allclose(alone, np.sqrt(2) * 0.5, rtol=1e-6)
    both = mode_deviations(of_amplitudes([2.0, 1.0], [5.0, 7.0]), deviation, noise)
    np.testing.assert_allclose(both[1], np.sqrt(2 * (0.09 + 0.16 / 5)), rtol=1e-6)
    assert (both[0] > both[1]).all()
    assert (both < alone[0, 0]).all()
