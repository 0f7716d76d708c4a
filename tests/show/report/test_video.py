"""Clips: small enough for a page, at a rate that a screen can follow."""

import io

import imageio.v3 as iio
import numpy as np
import pytest

from tg4mm.show.report import videos as video
from tg4mm.show.report.videos import clip, playing_rate


@pytest.mark.parametrize(("fps", "shown"), [(5, 5), (30, 30), (60, 60), (61, 30), (960, 30)])
def test_records_too_fast_for_a_screen_are_slowed_down(fps, shown):
    assert playing_rate(fps) == shown


def frames_of(data: bytes) -> np.ndarray:
    return iio.imread(io.BytesIO(data), extension=".mp4", plugin="FFMPEG")


def test_large_pictures_are_reduced_and_small_ones_enlarged():
    assert frames_of(clip(np.zeros((2, 900, 450, 3), np.uint8), 30, 0.1)).shape[1:3] == (720, 360)
    assert frames_of(clip(np.zeros((2, 48, 32, 3), np.uint8), 30, 0.1)).shape[1:3] == (384, 256)


def test_a_clip_that_is_too_large_is_made_smaller(monkeypatch):
    noise = np.random.default_rng(0).integers(0, 256, (4, 400, 400, 3), dtype=np.uint8)
    whole = clip(noise, 30, 0.1)
    monkeypatch.setattr(video, "_MOST", len(whole) // 2)
    assert len(clip(noise, 30, 0.1)) <= len(whole) // 2
