"""A video that walks and stands is told from one that does either."""

import numpy as np
import pytest

from tests.capture.sfm.videos import SIZE, looked, texture, write_video
from tg4mm.capture.sfm.clip import Clip
from tg4mm.capture.sfm.config import DEFAULTS, SfmConfig
from tg4mm.capture.sfm.sources import SWEEP, Sources
from tg4mm.capture.sfm.standing import divided

WALK, STAND = 60, 75  # frames at 30 Hz
HAND = 3.0  # pixels


def walked(n, at=0):
    return [at + 4 * k for k in range(n)]


def video(path, starts, jitter=0.0):
    """Cuts of one wide texture: frame i begins `starts[i]` pixels to the right, and a hand moves it by `jitter`."""
    rng, wide = np.random.default_rng(2), texture((SIZE[0] + 400, SIZE[1] + 40))
    frames = []
    for start in starts:
        x, y = np.rint(jitter * rng.standard_normal(2)).astype(int)
        cut = wide[20 + y : 20 + y + SIZE[1], start + 20 + x : start + 20 + x + SIZE[0]]
        frames.append(np.clip(cut + rng.normal(0, 3, cut.shape), 0, 255).astype(np.uint8))
    return write_video(path, frames)


def found(path, config=DEFAULTS):
    clip = Clip("cam", path, repeats=frozenset({1}))
    return divided(Sources(path, clips=(clip,)), [looked(path)], config)


@pytest.mark.parametrize(
    ("starts", "stands", "walks"),
    [
        (walked(WALK) + STAND * [4 * WALK], (2.0, 4.5), (0.0, 2.0)),
        (STAND * [0] + walked(WALK), (0.0, 2.5), (2.5, 4.5)),
    ],
)
def test_both_parts_are_found_in_either_order(tmp_path, starts, stands, walks):
    both = found(video(tmp_path / "one.mp4", starts))
    window = both.config.window
    assert window.start_s == pytest.approx(stands[0], abs=0.3)
    assert window.start_s >= stands[0] - 1e-6  # no picture of the walk
    assert window.stop_s == pytest.approx(stands[1], abs=0.3)
    (clip,), sweep = both.sources.clips, both.sources.sweep
    assert clip == Clip("cam", clip.path)  # whose repeats are looked for anew
    assert sweep == Clip(SWEEP, clip.path, window=both.parts.walks)
    assert (both.parts.walks.start_s, both.parts.walks.stop_s) == pytest.approx(walks, abs=0.3)
    assert str(both).startswith("the camera walks from")


@pytest.mark.parametrize(
    ("starts", "jitter"),
    [
        (walked(WALK + STAND), 0.0),  # walks all the time
        ((WALK + STAND) * [0], 0.0),  # stands all the time
        (walked(WALK) + STAND * [4 * WALK], HAND),  # a hand that stops walking
        (walked(WALK) + 20 * [4 * WALK], 0.0),  # stands for less than a second
        (walked(8) + STAND * [32], 0.0),  # is put down, no walk
    ],
)
def test_one_without_the_other_is_left_as_it_is(tmp_path, starts, jitter):
    assert found(video(tmp_path / "one.mp4", starts, jitter)) is None


@pytest.mark.parametrize(
    "own", [SfmConfig(kind="handheld"), SfmConfig(start_s=0.5), SfmConfig(stop_s=3.0)], ids=str
)
def test_what_the_user_says_overrules(tmp_path, own):
    path = video(tmp_path / "one.mp4", walked(WALK) + STAND * [4 * WALK])
    assert found(path) is not None
    assert found(path, own) is None
