"""Duplicate frames, mains flicker and vibrations that stand still at their turning points are not confused."""

import warnings
from fractions import Fraction

import numpy as np
import pytest
from scipy.ndimage import shift

from benchmarks.calibration.duplicates import duplicates_outcome, found_in
from tests.capture.sfm.videos import encoded, looked, still, texture, write_video
from tg4mm.capture.duplicates import DuplicateMeter
from tg4mm.capture.look import look
from tg4mm.capture.sfm.clip import Clip, TimeWindow
from tg4mm.capture.sfm.defects import stretches_of, warn_clocks
from tg4mm.capture.sfm.steadiness import NoveltyMeter
from tg4mm.capture.sfm.survey import survey_clip
from tg4mm.cli import main

RATES = [24, 24000 / 1001, 25, 30, 30000 / 1001, 48, 50, 60, 60000 / 1001, 90, 100, 120, 144, 200, 240]
SHARES = [Fraction(5, 6), Fraction(1, 6), Fraction(2, 5), Fraction(4, 5), Fraction(3, 5), Fraction(1, 2)]
GREY = texture((96, 64))[..., 1]
ALWAYS = np.ones(120, bool)


def met(pictures):
    """A meter that has seen these pictures [h, w], as if each were coded by itself."""
    meter = DuplicateMeter()
    for picture in pictures:
        meter.add(np.clip(np.rint(picture), 0, 255).astype(np.uint8), True, False)
    return meter


def noisy(n, shown, noise, level):
    """GREY times level(k), as shown(i) says which picture k frame i is."""
    rng = np.random.default_rng(0)
    taken = [GREY * level(k) + rng.normal(0, noise, GREY.shape) for k in range(max(map(shown, range(n))) + 1)]
    return [taken[shown(i)] for i in range(n)]


@pytest.mark.parametrize("noise", [0.5, 2.0])
@pytest.mark.parametrize("depth", [0.005, 0.03, 0.1])
@pytest.mark.parametrize("mains", [50, 60])
@pytest.mark.parametrize("fps", RATES)
def test_flickering_light_is_neither_frozen_nor_a_duplicate(fps, mains, depth, noise):
    pictures = noisy(120, int, noise, lambda k: 1 + depth * np.cos(4 * np.pi * mains * k / fps + 0.3))
    assert met(pictures).found() is None
    meter = NoveltyMeter()
    for picture in pictures:
        meter.add(np.clip(np.rint(picture), 0, 255).astype(np.uint8), True)
    assert not meter.hardly_changes(ALWAYS)
    assert not meter.frozen_frames(ALWAYS).any()


@pytest.mark.parametrize("share", SHARES)
@pytest.mark.parametrize("depth", [0, 0.03])
def test_duplicates_are_found_in_light_that_flickers_too(share, depth):
    pictures = noisy(
        120, lambda i: int(i * share), 2.0, lambda k: 1 + depth * np.cos(4 * np.pi * 50 * k / (30 * share))
    )
    found = met(pictures).found()
    assert found.share == share
    assert found.is_new.sum() == int(119 * share) + 1
    assert found.times(Fraction(30))[-1] == int(119 * share) / (30 * share)


def test_duplicates_at_random_are_found_and_the_others_keep_their_times():
    again = np.random.default_rng(5).random(150) < 0.2
    again[0] = False
    shown = np.cumsum(~again) - 1
    found = met(noisy(150, lambda i: int(shown[i]), 2.0, lambda k: 1.0)).found()
    assert found.share is None
    assert (found.is_new == ~again).all()
    assert found.times(Fraction(30)) == [Fraction(int(k), 30) for k in np.flatnonzero(~again)]


def test_a_still_scene_without_noise_has_no_duplicates():
    assert met([GREY] * 120).found() is None


@pytest.mark.parametrize("noise", [0.0, 0.5, 2.0])
@pytest.mark.parametrize("period", [2.5, 3.4325, 4, 6, 8, 13.7])
def test_a_vibrations_turning_points_are_no_duplicates(period, noise):
    slope = np.gradient(GREY, axis=1)
    rng = np.random.default_rng(0)
    for start in (0.0, 0.3, 0.5):
        moved = [GREY + 2 * np.sin(2 * np.pi * (k + start) / period) * slope for k in range(120)]
        assert met([m + rng.normal(0, noise, m.shape) for m in moved]).found() is None


def vibrating(noise=1.0, hz=4.37, shown=None, n=150):
    """Grey frames at 30 Hz, in the middle of which something vibrates by 0.8 px."""
    rng, base = np.random.default_rng(0), texture((160, 120))[..., 1]
    shown = np.arange(n) if shown is None else shown
    taken = []
    for k in range(shown[-1] + 1):
        picture = base.copy()
        moved_px = (0, 0.8 * np.sin(2 * np.pi * hz * k / 30))
        moved = shift(base[26:94, 36:124], moved_px, order=3, mode="nearest")
        picture[30:90, 40:120] = moved[4:-4, 4:-4]
        picture += rng.normal(0, noise, picture.shape)
        taken.append(np.repeat(np.clip(picture, 0, 255).astype(np.uint8)[..., None], 3, 2))
    return [taken[k] for k in shown]


@pytest.mark.parametrize("crf", [16, 22])
def test_look_and_sfm_keep_every_frame_of_a_vibration_whose_noise_the_codec_took(tmp_path, crf):
    path = write_video(tmp_path / "a.mp4", vibrating(), crf=crf)
    found = look(path)
    assert found.repeats == ()
    assert looked(path).repeats == ()
    strongest = found.vibrations[0]
    assert strongest.hz == pytest.approx(4.37, abs=0.005)
    assert strongest.amplitude_px == pytest.approx(0.8, rel=0.15)


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_no_duplicates_in_films_without_any(tmp_path, seed):
    outcome = duplicates_outcome(seed, tmp_path)
    assert (outcome.kind, outcome.duplicates, outcome.false) == ("none", 0, 0)


@pytest.mark.parametrize("share", [Fraction(5, 6), Fraction(1, 6), Fraction(4, 5)])
def test_a_video_keeps_new_pictures_and_their_times(tmp_path, share):
    rng, base = np.random.default_rng(0), texture()
    slope = np.gradient(base, axis=1)
    taken = [
        np.clip(base + 2 * np.sin(0.9 * k) * slope + rng.normal(0, 3, base.shape), 0, 255).astype(np.uint8)
        for k in range(int(150 * share) + 1)
    ]
    path = encoded(tmp_path / "a.mp4", [taken[int(i * share)] for i in range(150)], "libx264", crf="18")
    survey = looked(path)
    assert survey.fps == 30 * share
    assert len(survey) == int(149 * share) + 1
    assert survey.clock()[1] == pytest.approx(np.arange(len(survey)) / float(30 * share))
    assert not stretches_of(survey, True).faults
    said = f"{share.numerator} of {share.denominator} frames are new pictures.* --keep-duplicates keeps them"
    with pytest.warns(UserWarning, match=said):
        warn_clocks([survey], None)


def test_the_option_keeps_duplicates_everywhere(tmp_path, capsys):
    path = write_video(tmp_path / "a.mp4", vibrating(6.0, shown=np.arange(150) * 4 // 5), crf=10)
    assert found_in(path).share == Fraction(4, 5)
    assert len(look(path).times_s) == 120
    assert len(look(path, keep_duplicates=True).times_s) == 150
    clip = Clip("a", path)
    assert len(survey_clip(clip, tmp_path / "all", TimeWindow(), keep_duplicates=True)) == 150
    assert main(["look", str(path), "--png", str(tmp_path / "a.png")]) == 0
    assert "30 duplicate frames: they are left out" in capsys.readouterr().out
    assert main(["look", str(path), "--keep-duplicates", "--png", str(tmp_path / "a.png")]) == 0
    out = capsys.readouterr().out
    assert "duplicate frames" not in out
    assert "--keep-duplicates --out" in out  # the command that comes next


@pytest.mark.parametrize("share", [Fraction(5, 6), Fraction(1, 2), Fraction(1)])
def test_duplicates_that_a_codec_stores_anew_are_found(tmp_path, share):
    """A fast encoder refines the repeated picture, so that hardly any block is the same bit for bit."""
    film = vibrating(4.0, shown=np.floor(np.arange(150) * float(share) + 1e-9).astype(int))
    path = encoded(tmp_path / "a.mp4", film, "libx264", crf="18", preset="ultrafast")
    found = found_in(path)
    assert (found is None) if share == 1 else (found is not None and found.share == share)


def test_irregular_duplicates_of_a_video_are_left_out_and_said(tmp_path):
    again = np.random.default_rng(3).random(160) < 0.25
    again[0] = False
    film = vibrating(6.0, shown=np.cumsum(~again) - 1)
    path = encoded(tmp_path / "a.mp4", film, "libx264", crf="8", preset="veryfast")
    survey = looked(path)
    left_out = set(survey.repeats)
    assert left_out <= set(np.flatnonzero(again).tolist())
    assert len(left_out) > 0.7 * again.sum()
    kept = [k for k in range(160) if k not in left_out]
    assert survey.clock()[1] == pytest.approx(np.array(kept) / 30)
    with pytest.warns(UserWarning, match=r"frames are duplicates of the one before them, in no pattern"):
        warn_clocks([survey], None)


@pytest.mark.parametrize("crf", [28, 40])
def test_a_still_film_of_a_low_bit_rate_is_answered(tmp_path, capsys, crf):
    path = write_video(tmp_path / "a.mp4", still(60, noise=1.0), crf=crf)
    assert main(["look", str(path), "--png", str(tmp_path / "a.png")]) == 0
    assert "no vibration stands out" in capsys.readouterr().out
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert main(["sfm", str(path), "--out", str(tmp_path / "out")]) == 0


def test_a_rate_that_jitters_is_kept(tmp_path):
    rng = np.random.default_rng(0)
    ticks = np.round(np.arange(100) * 3000 + rng.normal(0, 135, 100)).astype(int)  # 1.5 ms of 90 kHz
    ticks = np.delete(ticks - ticks[0], [20, 21, 60])  # and dropped frames
    path = write_video(tmp_path / "a.mp4", still(97), 30, ticks.tolist(), Fraction(1, 90000))
    survey = looked(path)
    fps, times = survey.clock()
    assert times == pytest.approx(ticks / 90000, abs=1e-6)
    assert fps == pytest.approx(30, rel=0.01)
    with pytest.warns(UserWarning, match="the frame rate varies"):
        warn_clocks([survey], None)


@pytest.mark.parametrize(("runs", "is_found"), [((8, 28), False), ((6, 17, 25, 41, 55, 66, 79, 91), True)])
def test_frames_that_a_codec_skips_together_are_one_decision(runs, is_found):
    """Two groups of three B-frames and a P-frame that repeat; and eight single frames, spread over the groups."""
    again = {k + 1 + i for k in runs for i in range(1 if is_found else 4)}
    rng, meter = np.random.default_rng(3), DuplicateMeter()
    for k in range(100):
        if k == 0 or k not in again:
            picture = np.clip(np.rint(GREY + rng.normal(0, 3, GREY.shape)), 0, 255).astype(np.uint8)
        meter.add(picture, k == 0, k % 4 != 0)
    found = meter.found()
    assert (found is not None and set(found.rows) == again) if is_found else found is None
