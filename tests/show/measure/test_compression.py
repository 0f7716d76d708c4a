"""Peaks that a video codec made of a stronger vibration say so; no others do."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.show.measure.filmed import BALL_SPHERE, of_parts, run_of, sine
from tg4mm.capture import load_capture
from tg4mm.capture.scene import codec_period
from tg4mm.core.errors import CaptureError
from tg4mm.show.measure import measure, parse_sensor, prepare
from tg4mm.show.measure.spectrum import Peak, Sideband, spectrum_of, with_sidebands

FPS = 30.0
TIMES = np.arange(90) / FPS


def test_what_a_modulation_with_the_codecs_period_makes_is_marked():
    """A motion of which every fourth frame keeps all and the others nine tenths."""
    kept = np.where(np.arange(90) % 4 == 0, 1.0, 0.9)
    values = (kept * np.cos(2 * np.pi * 3.4 * TIMES + 0.4))[:, None] * np.ones(3)
    noise = 1e-3 * np.random.default_rng(0).normal(size=(90, 3))
    peaks = spectrum_of(TIMES, values + noise, np.full((90, 3), 1e-3)).peaks
    found = {round(p.frequency_hz, 1): p.sideband for p in with_sidebands(peaks, 4, FPS, 3.0)}
    assert found.keys() == {3.4, 4.1, 10.9, 11.6}
    assert found[3.4] is None
    assert found[4.1] == Sideband(7.5, pytest.approx(3.4, abs=1e-2), False)
    assert found[10.9] == Sideband(7.5, pytest.approx(3.4, abs=1e-2), True)
    assert found[11.6] == Sideband(15.0, pytest.approx(3.4, abs=1e-2), False)
    assert str(Sideband(7.5, 3.399, False)) == "may be of the video's compression: 7.5 − 3.399 Hz"
    assert all(p.sideband is None for p in with_sidebands(peaks, None, FPS, 3.0))


def peak(hz, size, deviation=1e-3):
    return Peak(hz, 1e-3, size * np.ones(3, complex), deviation * np.ones(3), 1e-3 * np.ones(3))


@pytest.mark.parametrize(("deviation", "is_marked"), [(1e-3, False), (0.1, True)])
def test_half_of_a_line_is_marked_where_it_may_be_less(deviation, is_marked):
    strong, other = with_sidebands([peak(3.4, 1.0), peak(4.1, 0.5, deviation)], 4, FPS, 3.0)
    assert (strong.sideband, other.sideband is not None) == (None, is_marked)


@pytest.mark.parametrize(("hz", "size"), [(4.5, 0.01), (4.1, 0.5)])
def test_other_frequencies_and_strong_ones_are_not(hz, size):
    strong, other = with_sidebands([peak(3.4, 1.0), peak(hz, size)], 4, FPS, 3.0)
    assert strong.sideband is None
    assert other.sideband is None


def test_a_run_knows_it_by_its_datasets_scene_json(tmp_path):
    run = run_of(tmp_path, of_parts(ball=sine(4.0, [0.02, 0, 0.015])), n_timesteps=45)
    path = run.dataset / "scene.json"
    assert codec_period(run.dataset) is None
    values = json.loads(path.read_text())
    path.write_text(json.dumps(values | {"codec_period": 4}))
    found = measure(prepare(run, keep=False), [parse_sensor(BALL_SPHERE)])["ball"]
    assert found.codec_period == 4
    assert found.spectrum.peaks[0].sideband is None
    path.write_text(json.dumps(values | {"codec_period": 250}))
    assert codec_period(run.dataset) is None
    path.write_text(json.dumps(values | {"codec_period": "four"}))
    with pytest.raises(CaptureError, match="codec_period"):
        load_capture(run.dataset)
    assert replace(found, codec_period=None).spectrum.peaks
