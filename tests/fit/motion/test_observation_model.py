"""What one pose's pictures show of motion: adjoint and normal operator belong to it, and each row has its own time."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fit.motion.scenes import inner, problem, two_cameras, weights_of
from tg4mm.core.even_clock import delayed, later
from tg4mm.fit.motion.observation_model import ObservationModel, project
from tg4mm.fit.motion.observations import PosedFrames

TIMES = np.arange(80) / 20


def frames(readout_s=0.0):
    _, (camera, _) = two_cameras()
    return PosedFrames("", camera.viewmat, camera.K, np.arange(len(TIMES)), TIMES, readout_s)


@pytest.mark.parametrize("nuisance", [None, slice(0, 6), slice(0, 12)], ids=["none", "exposure", "all"])
@pytest.mark.parametrize("weighted", [False, True])
def test_the_adjoint_is_the_transpose_and_the_normal_operator_both(nuisance, weighted):
    p = problem(nuisance=nuisance or slice(0, 0))
    weights = weights_of(p)[0] if weighted else None
    model = ObservationModel.of(frames(), p.nuisances[0], p.means[0], weights)
    rng = np.random.default_rng(0)
    x = rng.normal(size=(2, p.n_gaussians, 6)).astype(np.float32)
    y = rng.normal(size=(2, *p.means[0].shape)).astype(np.float32)
    shown = model.apply(x)
    of_pixels = y if weights is None else y * weights[..., None]
    assert inner(shown, of_pixels) == pytest.approx(inner(x, model.adjoint(y)), rel=1e-3)
    normal = model.normal(x)
    scale = np.abs(normal).max()
    np.testing.assert_allclose(normal, model.adjoint(shown), atol=2e-4 * scale)
    if nuisance is not None:
        columns = p.nuisances[0].columns(p.means[0])
        plain = replace(model, projection=None)
        assert np.abs(model.adjoint(columns)).max() < 1e-3 * np.abs(plain.adjoint(columns)).max()


@pytest.mark.parametrize("hz", [0.7, 3.1, 8.0])
def test_rows_that_are_read_one_after_another_show_what_all_at_once_would(hz):
    """A swing read over 40 ms: without the rows' times the last row's phase is off by up to two radians."""
    height, readout = 16, 0.04
    late = readout * ((np.arange(height) + 0.5) / height - 0.5)
    swing = np.cos(2 * np.pi * hz * (TIMES[:, None] + late))
    strip = np.repeat(swing[:, :, None, None], 3, 3).astype(np.float32)
    functions = np.stack([np.cos(2 * np.pi * hz * TIMES), -np.sin(2 * np.pi * hz * TIMES)]) / 40
    by_rows = project(frames(readout), height, slice(0, height), strip, functions)[..., 0, 0]
    at_once = project(frames(), height, slice(0, height), strip, functions)[..., 0, 0]
    phase = np.angle(by_rows[0] + 1j * by_rows[1])
    assert np.ptp(phase) < 0.1 * np.ptp(2 * np.pi * hz * late)
    np.testing.assert_allclose(np.hypot(*by_rows), 1, atol=0.05)
    assert np.ptp(np.angle(at_once[0] + 1j * at_once[1])) == pytest.approx(
        2 * np.pi * hz * np.ptp(late), rel=0.1
    )
    part = project(frames(readout), height, slice(4, 9), strip[:, 4:9], functions)[..., 0, 0]
    np.testing.assert_allclose(part, by_rows[:, 4:9], atol=1e-6)


def test_a_delay_of_whole_frames_moves_the_samples():
    series = np.random.default_rng(1).normal(size=(2, 80))
    np.testing.assert_allclose(delayed(series, 0), series, atol=1e-12)
    np.testing.assert_allclose(delayed(series, 1)[:, 20:-20], series[:, 21:-19], atol=1e-12)


def test_of_uneven_times_functions_are_interpolated_between_them():
    times = TIMES + np.where(np.arange(80) % 7 == 3, 0.02, 0.0)
    functions = np.stack([np.cos(2 * np.pi * 2.0 * times), np.ones(80)])
    found = later(times, functions, 0.013)[:, 2:-2]
    np.testing.assert_allclose(found[0], np.cos(2 * np.pi * 2.0 * (times + 0.013))[2:-2], atol=0.01)
    np.testing.assert_allclose(found[1], 1, atol=1e-9)
    assert later(times, functions[:0], 0.013).shape == (0, 80)
