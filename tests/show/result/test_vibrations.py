"""Lines, bands, deviations, and what a flat capture's regions show."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fit.motion.scenes import of_amplitudes
from tests.helpers.look import found
from tg4mm.capture.sfm.dataset import VIEWMAT
from tg4mm.core.magnification import check_band
from tg4mm.core.phasors import series_modes
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.show.measure.measurement import region_sensors
from tg4mm.show.result.advice import suggested_bands
from tg4mm.show.result.looked import looked_notes, looked_vibrations
from tg4mm.show.result.model import line_near, mode_deviations, phasors_at, why_no_damping, with_deviation
from tg4mm.show.result.read import not_of_light

FPS, N = 30.0, 120
T = np.arange(N) / FPS
K = np.array([[64.0, 0, 32], [0, 64.0, 25], [0, 0, 1]])
CAPTURE = SimpleNamespace(viewmats=VIEWMAT[None], Ks=K[None])


def ringing(hz, decay):
    return np.exp(-decay * T) * np.cos(2 * np.pi * hz * T)


def test_a_bin_beside_what_rings_down_becomes_its_line():
    rng = np.random.default_rng(0)
    line = line_near(ringing(5.13, 1.0) + 0.01 * rng.normal(size=N), FPS, 5.0, [9.0], 0.0)
    assert abs(line.hz - 5.13) < 3 * line.hz_deviation < 0.02
    assert line.damping == pytest.approx(1.0 / np.hypot(1.0, 2 * np.pi * 5.13), rel=0.05)
    assert why_no_damping(line) == ""


def test_noise_that_is_known_from_elsewhere_is_in_the_deviation():
    clean = line_near(ringing(5.2, 0.0), FPS, 5.2, [], 0.0)
    known = line_near(ringing(5.2, 0.0), FPS, 5.2, [], 0.1)
    assert clean.hz_deviation < 1e-5
    bound = np.sqrt(6) * 0.1 / np.sqrt(2) / (np.pi * np.sqrt(N) * N / FPS)
    assert known.hz_deviation == pytest.approx(bound, rel=0.1)


@pytest.mark.parametrize(
    ("size", "decay", "said"),
    [(1.0, 0.0, "stays constant"), (1.0, -1.0, "grows"), (0.04, 0.0, "noise hides")],
)
def test_what_is_said_of_its_strength_is_tested(size, decay, said):
    rng = np.random.default_rng(3)
    line = line_near(size * ringing(5.2, decay) + 0.05 * rng.normal(size=N), FPS, 5.2, [], 0.0)
    assert said in why_no_damping(line)


def test_phasors_are_those_of_the_line_in_all_bins_together():
    shape = np.array([[1.0, 0.0, 0.5], [0.0, 2.0, 0.0]])
    series = ringing(5.13, 1.0)[:, None, None] * shape
    hz, values = series_modes(series, FPS)
    motion = ModalMotion.of_phasors(hz, values, np.zeros_like(values), FPS, N)
    line = line_near(ringing(5.13, 1.0), FPS, 5.13, [], 0.0)
    assert line is not None
    np.testing.assert_allclose(phasors_at(motion, line), shape, atol=0.01)
    b_frames = np.arange(N) % 4 != 0
    np.testing.assert_allclose(phasors_at(motion, line, b_frames), shape, atol=0.01)


@settings(deadline=None)
@given(
    hz=st.lists(st.floats(0.7, 14.9), min_size=1, max_size=5, unique=True),
    deviation=st.floats(1e-5, 3.0),
    duration=st.floats(0.5, 100.0),
)
def test_each_is_a_valid_band_around_its_own_frequency(hz, deviation, duration):
    usable = [f for f in hz if f > 1 / duration]
    if any(abs(a - b) < 0.01 for a in usable for b in usable if a != b):
        return
    bands = suggested_bands(usable, [deviation] * len(usable), duration, 30.0)
    for f, (low, high) in zip(usable, bands, strict=True):
        assert check_band((low, high), 30.0) == (low, high)
        assert low <= f <= high
        assert [g for g in usable if low < g < high] == [f]


def test_a_single_mode_takes_the_whole_error_and_a_weak_one_its_share():
    """Amplitude: √2 times the rms over time."""
    deviation, noise = np.full(50, 0.5), np.full(50, 0.3)
    alone = mode_deviations(of_amplitudes([2.0], [5.0]), deviation, noise)
    np.testing.assert_allclose(alone, np.sqrt(2) * 0.5, rtol=1e-6)
    both = mode_deviations(of_amplitudes([2.0, 1.0], [5.0, 7.0]), deviation, noise)
    np.testing.assert_allclose(both[1], np.sqrt(2 * (0.09 + 0.16 / 5)), rtol=1e-6)
    assert (both[0] > both[1]).all()
    assert (both < alone[0, 0]).all()


def test_a_line_is_a_vibration_in_pixels_and_scene_units_at_its_place():
    (v,) = looked_vibrations(found(), CAPTURE, fps=30.0, duration_s=6.0)
    assert (v.hz, v.deviation_hz) == (5.2, 0.01)
    assert (v.pixels.value, v.pixels.deviation) == (0.12, 0.004)
    assert v.amplitude.value == pytest.approx(0.12 / 64)
    assert v.position == pytest.approx(((40 - 32) / 64, 1.0, (25 - 24) / 64))
    assert v.damping == 0.02
    assert v.band[0] < 5.2 < v.band[1]


def test_parts_that_move_at_one_frequency_share_its_band_and_have_sensors_of_their_own():
    first = found()
    other = replace(first.lines[0], amplitude_px=0.05, direction=(0.8, 0.6), centre_px=(10.0, 40.0))
    both = replace(first, lines=(first.lines[0], other))
    one, two = looked_vibrations(both, CAPTURE, fps=30.0, duration_s=6.0)
    (alone,) = looked_vibrations(first, CAPTURE, fps=30.0, duration_s=6.0)
    assert one.band == two.band == alone.band
    assert two.pixels.value == 0.05
    scene = SimpleNamespace(observations=SimpleNamespace(frames=[SimpleNamespace(name="r_000")]))
    sensors = region_sensors(scene, both)
    assert [sensor.name for sensor in sensors] == ["5.2 Hz", "5.2 Hz 2"]
    assert sensors[1].values[:2] == (10.0, 40.0)


def test_motion_at_the_frequency_of_the_light_is_in_doubt_unless_a_region_shows_it():
    (line,) = looked_vibrations(found(), CAPTURE, fps=30.0, duration_s=6.0)
    model = (replace(line, hz=9.998), line)
    in_light, other = not_of_light(model, found(), duration_s=6.0)
    assert "the light flickers there by 2 %" in in_light.doubt
    assert not other.doubt
    assert not not_of_light(model, found(hz=10.01), duration_s=6.0)[0].doubt
    assert not_of_light(model, found("light", hz=10.01), duration_s=6.0)[0].doubt


def test_a_marked_line_is_no_vibration_and_the_notes_say_why():
    marked = found("2 × 2.600 Hz")
    notes = looked_notes(marked)
    assert any("5.2 Hz (0.12 px at (40, 24)): 2 × 2.600 Hz" in note for note in notes)
    assert not any("5.2 Hz" in note for note in looked_notes(found()))


def test_an_amplitude_that_the_codec_took_from_is_said_to_be_larger():
    seen = found()
    lost = replace(seen, lines=(replace(seen.lines[0], lost="smaller than the codec lets through"),))
    said = "the amplitude above 0.12 px at 5.2 Hz at (40, 24): smaller than the codec lets through"
    assert said in looked_notes(lost)
    assert said not in looked_notes(seen)
    for look, shown in ((seen, "0.1200 ± 0.0040"), (lost, "> 0.1200 ± 0.0040")):
        assert with_deviation(looked_vibrations(look, CAPTURE, fps=30.0, duration_s=6.0)[0].pixels) == shown


def test_what_moves_by_itself_and_the_light_are_said():
    notes = " ".join(looked_notes(found()))
    assert "pixels (0, 0) and (16, 16): an object there moves independently, periodically at 7.5 Hz" in notes
    assert "it flickers at 10 Hz" in notes
