"""Linear magnification: of a series, and of modal motion, where it is what `modal` does."""

import numpy as np
import pytest

from tg4mm.core.filters import TemporalFilter, bins
from tg4mm.core.magnification import BandGain, Magnification
from tg4mm.fit.magnify.linear import magnified_motion, magnified_series
from tg4mm.fit.motion.animate import displacement_at, rotation_at
from tg4mm.fit.motion.modes import ModalMotion

FPS = 30.0
IDEAL = TemporalFilter("ideal")


def motion(freqs, n_timesteps, seed=0):
    rng = np.random.default_rng(seed)
    shape = (2, len(freqs), 7, 3)
    phasors = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(np.complex64)
    return ModalMotion(np.array(freqs), phasors[0], 0.1 * phasors[1], FPS, n_timesteps)


@pytest.mark.parametrize("n", [30, 45, 60])
def test_ideal_bands_on_dft_bins_are_what_modal_does(n):
    m = motion([2.0, 4.0, 6.0, 10.0], n)
    plan = Magnification((BandGain(3.5, 6.5, 20.0), BandGain(9, 11, -1.0)), filter=IDEAL)
    linear, alphas = magnified_motion(m, plan), plan.ideal(m.freqs_hz)
    for t in range(n):
        for at in (displacement_at, rotation_at):
            np.testing.assert_allclose(at(linear, t), at(m, t, alphas), atol=1e-4)


def test_the_published_filter_puts_its_phase_error_into_the_result():
    m = motion([5.0], 30)
    wrong, right = (
        magnified_motion(m, Magnification((BandGain(3.5, 6.5, 50.0),), filter=TemporalFilter(kind)))
        for kind in ("published", "zero-phase")
    )
    series = {
        name: np.stack([displacement_at(x, t) for t in range(30)])
        for name, x in (("wrong", wrong), ("right", right))
    }
    truth = np.stack([displacement_at(m, t, 50.0) for t in range(30)])
    np.testing.assert_allclose(series["right"], truth, atol=2e-3)
    # 50 of the 51 parts are turned by 30°: 2 sin(15°) · 50/51
    error = np.linalg.norm(series["wrong"] - truth) / np.linalg.norm(truth)
    assert error == pytest.approx(0.5176 * 50 / 51, abs=1e-3)


def test_the_series_is_filtered_relative_to_timestep_0():
    rng = np.random.default_rng(0)
    series = 1000 + rng.standard_normal((30, 4))
    everything = magnified_series(series, np.full(16, 4.0))
    np.testing.assert_allclose(everything, series + 4 * (series - series[0]), atol=1e-9)
    band = IDEAL.response((3.5, 6.5), bins(30, FPS), FPS)
    outside = magnified_series(series, 50 * (1 - band))
    change = np.fft.rfft(outside - series, axis=0)
    assert np.abs(change[4:7]).max() < 1e-8
