"""Pictures shown twice, mains flicker and vibrations that stand still at their turning points: told apart."""

from fractions import Fraction

import numpy as np
import pytest

from tests.capture.sfm.videos import encoded, looked, still, texture, write_video
from tg4mm.capture.sfm.defects import stretches_of, warn_clocks
from tg4mm.capture.sfm.frozen import NoveltyMeter

RATES = [24, 24000 / 1001, 25, 30, 30000 / 1001, 48, 50, 60, 60000 / 1001, 90, 100, 120, 144, 200, 240]
SHARES = [Fraction(5, 6), Fraction(1, 6), Fraction(2, 5), Fraction(4, 5), Fraction(3, 5)]
GREY = texture((96, 64))[..., 1]


def met(pictures):
    """A meter that has seen these pictures [h, w], as if each were coded by itself."""
    meter = NoveltyMeter()
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
def test_flickering_light_is_neither_frozen_nor_repeated(fps, mains, depth, noise):
    pictures = noisy(120, int, noise, lambda k: 1 + depth * np.cos(4 * np.pi * mains * k / fps + 0.3))
    meter = met(pictures)
    assert meter.repeats is None
    assert not meter.is_frozen()
    assert not meter.frozen_frames().any()


@pytest.mark.parametrize("share", SHARES)
@pytest.mark.parametrize("depth", [0, 0.03])
def test_repeats_are_found_in_light_that_flickers_too(share, depth):
    pictures = noisy(
        120, lambda i: int(i * share), 2.0, lambda k: 1 + depth * np.cos(4 * np.pi * 50 * k / (30 * share))
    )
    found = met(pictures).repeats
    assert found.share == share
    assert found.is_new.sum() == int(119 * share) + 1
    assert found.times(Fraction(30))[-1] == int(119 * share) / (30 * share)


def test_a_vibration_of_whole_frames_is_no_repeat():
    slope = np.gradient(GREY, axis=1)
    for period in (4, 6, 8):
        moved = [GREY + 2 * np.sin(2 * np.pi * (k + 0.5) / period) * slope for k in range(120)]
        rng = np.random.default_rng(0)
        assert met([m + rng.normal(0, 0.5, m.shape) for m in moved]).repeats is None


@pytest.mark.parametrize("share", [Fraction(5, 6), Fraction(1, 6)])
def test_a_video_keeps_new_pictures_and_their_times(tmp_path, share):
    rng, base = np.random.default_rng(0), texture()
    slope = np.gradient(base, axis=1)
    taken = [
        np.clip(base + 2 * np.sin(0.8 * k) * slope + rng.normal(0, 3, base.shape), 0, 255).astype(np.uint8)
        for k in range(int(150 * share) + 1)
    ]
    path = encoded(tmp_path / "a.mp4", [taken[int(i * share)] for i in range(150)], "libx264", crf="18")
    survey = looked(path)
    assert survey.fps == 30 * share
    assert len(survey) == int(149 * share) + 1
    assert survey.clock()[1] == pytest.approx(np.arange(len(survey)) / float(30 * share))
    assert not stretches_of(survey, True).faults
    with pytest.warns(UserWarning, match=f"{share.numerator} of {share.denominator} frames are new pictures"):
        warn_clocks([survey], None)


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
