"""A video is measured without a dataset and without training."""

import json
from fractions import Fraction

import numpy as np
import pytest

from benchmarks.calibration.film import Coding, Film, FilmMode, Layer, texture
from benchmarks.calibration.film import write_video as write_film
from tests.capture.sfm.videos import write_video
from tests.capture.tracking.test_region import FPS, FRAMES, SIDE, TIMES, moving, wave
from tg4mm.cli import main
from tg4mm.core.errors import Tg4mmError
from tg4mm.show.measure import measure, parse_sensor, prepare_video
from tg4mm.show.measure.limits import with_losses
from tg4mm.show.measure.measurement import measure_one
from tg4mm.show.measure.spectrum import orbit_of

SENSOR = "plate=pixel:film,32,32,18"


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """Two seconds of a plate that moves by .4 px at 3.3 Hz, +0.8 right and 0.6 up."""
    frames = np.clip(moving(wave(0.4), 0), 0, 255).astype(np.uint8)[..., None].repeat(3, 3)
    return write_video(tmp_path_factory.mktemp("video") / "film.mp4", list(frames), Fraction(30), crf=4)


def test_the_motion_of_a_region_is_measured_with_its_deviation(video, tmp_path):
    out = tmp_path / "out"
    assert main(["measure", str(video), "--out", str(out), "--sensor", SENSOR]) == 0
    found = json.loads((out / "measure.json").read_text())
    plate = found["sensors"][0]
    peak = plate["peaks"][0]
    assert found["run"] is None
    assert found["printed_unit"] == "px"
    assert peak["frequency_hz"] == pytest.approx(3.3, abs=0.02)
    for k, true in enumerate((0.32, 0.24)):
        assert abs(peak["amplitude"][k] - true) < 2.5 * peak["deviation"][k] + 0.002
    assert {f.name for f in out.iterdir()} >= {"regions.png", "series.csv", "measure.uff", "plots"}


def test_a_readout_moves_each_regions_times_to_its_rows(video):
    upper, lower = (parse_sensor(f"{n}=pixel:film,32,{y},8") for n, y in (("upper", 14), ("lower", 50)))
    found = measure(prepare_video(video, readout_s=0.02), [upper, lower])
    assert found["lower"].times_s[0] - found["upper"].times_s[0] == pytest.approx(0.02 * 36 / SIDE, abs=0.001)


def test_without_a_sensor_what_vibrates_is_measured(video):
    found = measure(prepare_video(video))
    assert found.sensors[-1].name == "all"
    whole = found["all"].series.displacement - wave(0.4)[:, 0] * [1, -1]
    assert np.sqrt(((whole - whole.mean(0)) ** 2).mean()) < 0.02
    assert len(found["all"].times_s) == FRAMES == len(TIMES)
    assert found["all"].times_s[1] == pytest.approx(1 / FPS)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--sensor", "a=box:0,0,0,1,1,1"], "a box needs a trained run; expected pixel, polygon or all"),
        (["--sensor", "a=pixel:other,3,3"], "'other' is not a camera; cameras: film"),
        (["--sensor", "a=pixel:film,99,3"], "lies outside the picture of 64×64"),
        (["--readout", "50"], "--readout is 50 ms, expected at most the 33.33 ms of a frame"),
        (["--fps", "-3"], "--fps"),
    ],
)
def test_what_cannot_be_measured_is_one_line(video, tmp_path, capsys, words, message):
    assert main(["measure", str(video), "--out", str(tmp_path / "out"), *words]) == 2
    assert message in capsys.readouterr().err


def test_a_plain_region_is_refused(tmp_path):
    frames = [np.full((48, 64, 3), 120, np.uint8) for _ in range(30)]
    video = write_video(tmp_path / "plain.mp4", frames, Fraction(30), crf=4)
    with pytest.raises(Tg4mmError, match="no texture"):
        measure(prepare_video(video), [parse_sensor("a=pixel:plain,30,20,9")])


# of films whose steady vibration seems to ring down, as x264 takes more of it later: seed, crf, noise, contrast, Hz, px
_REFINED = [(5, 20, 1.6, 0.06, 6.04, 0.158), (8, 22, 2.2, 0.1, 4.3, 0.15)]


def coded(path, seed, crf, noise, contrast, motion, px, covered=()):
    """The line at a plate's motion, px times a function of time, in a coded film of 8 s.

    In the `covered` frames a grey bar passes in front of the plate.
    """
    rng, (h, w) = np.random.default_rng(seed), (120, 160)
    back = texture(h, w, rng, 0.3, 0.2, (2.0, 5.0, 15.0))
    plate = texture(h, w, rng, 0.35, contrast, (1.5, 4.0, 12.0))
    mode = FilmMode(np.broadcast_to([px * 0.8, px * 0.6], (h, w, 2)), motion)
    layers = [Layer(back, None, [], 0.6), Layer(plate, (40, 30, 120, 90), [mode], 0.6)]
    shown = Film(layers, 30, 240, noise, seed=seed).pictures()
    for k, n in enumerate(covered):
        shown[n, :, 2 * k + 30 : 2 * k + 50] = 110
    write_film(path, shown, 30, Coding("libx264", 0, crf=crf))
    scene = prepare_video(path)
    (result,) = with_losses(scene, [measure_one(scene, parse_sensor(f"a=pixel:{path.stem},80,60,25"))])
    return result, result.spectrum.peaks[0]


@pytest.mark.parametrize("film", _REFINED)
def test_a_steady_vibration_that_a_codec_fades_has_no_damping(tmp_path, film):
    *how, hz, px = film
    result, peak = coded(tmp_path / "f.mp4", *how, lambda t: float(np.cos(2 * np.pi * hz * t + 1)), px)
    assert abs(peak.frequency_hz - hz) < 0.02
    assert peak.line.change in ("steady", "untold")
    assert result.damping[0] is None


@pytest.mark.parametrize("seed", [3, 7])
def test_a_region_whose_parts_move_differently_has_a_mark_in_place_of_a_test(tmp_path, seed):
    """The test would move a region as one, but what it shows of the plate moves and the rest stands."""
    motion = lambda t: float(np.cos(2 * np.pi * 4.4 * t + seed))  # noqa: E731
    plate, _ = coded(tmp_path / "f.mp4", seed, 22, 1.5, 0.3, motion, 0.5)
    scene = prepare_video(tmp_path / "f.mp4")
    (whole,) = with_losses(scene, [measure_one(scene, parse_sensor("a=pixel:f,112,88,28"))])
    assert plate.spread < 0.5 < whole.spread
    assert not plate.losses[0].why
    assert whole.losses
    assert all("move differently" in loss.why for loss in whole.losses)


def test_a_lossless_film_has_no_mark_where_parts_move_differently(tmp_path):
    coded(tmp_path / "f.mp4", 3, 0, 1.5, 0.3, lambda t: float(np.cos(2 * np.pi * 4.4 * t)), 0.5)
    scene = prepare_video(tmp_path / "f.mp4")
    (whole,) = with_losses(scene, [measure_one(scene, parse_sensor("a=pixel:f,112,88,28"))])
    assert whole.spread > 0.5
    assert whole.losses
    assert all(loss.gain == 1 and not loss.why for loss in whole.losses)


@pytest.mark.parametrize("seed", [3, 7])
def test_what_rings_down_in_a_coded_film_has_its_damping(tmp_path, seed):
    """As it fades, the codec takes more of it; the test of the codec tells how much that may be."""
    decay = 0.03 * 2 * np.pi * 3.18

    def motion(t):
        return float(np.exp(-decay * t) * np.cos(2 * np.pi * 3.18 * t + 1))

    result, peak = coded(tmp_path / "f.mp4", seed, 22, 2.2, 0.07, motion, 0.5)
    assert peak.line.change == "decays"
    assert abs(result.damping[0].ratio - 0.03) < 3 * result.damping[0].deviation < 0.06


@pytest.mark.parametrize("seed", [1, 2])
def test_a_strong_vibration_that_rings_down_in_a_coded_film_is_not_taken_for_something_that_passes(
    tmp_path, seed
):
    """The codec leaves parts of the picture behind, mostly in the first frames, which move most."""
    decay = 0.02 * 2 * np.pi * 4.4
    motion = lambda t: float(np.exp(-decay * t) * np.cos(2 * np.pi * 4.4 * t + seed))  # noqa: E731
    result, _ = coded(tmp_path / "f.mp4", seed, 24, 1.5, 0.3, motion, 1.2)
    assert not result.motion.hidden[:60].any()
    assert result.motion.is_iterated
    true = 1.2 * np.array([motion(t) for t in result.times_s[:60]])
    error = result.displacement[:60] @ [0.8, -0.6] - true
    assert np.sqrt((error**2).mean()) < 0.25 * np.sqrt((true**2).mean())


@pytest.mark.parametrize("px", [0.5, 0.8])
def test_frames_in_which_something_passes_take_nothing_from_the_amplitude(tmp_path, px):
    motion = lambda t: float(np.cos(2 * np.pi * 4.4 * t + 1))  # noqa: E731
    result, peak = coded(tmp_path / "f.mp4", 2, 16, 1.0, 0.3, motion, px, range(100, 145))
    assert result.motion.hidden[110:135].mean() > 0.8
    # Interpolated in the hidden frames it would be a quarter less.
    assert orbit_of(peak).amplitude == pytest.approx(px, rel=0.05)
