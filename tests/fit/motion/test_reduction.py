"""How much of a recording is read: all of a short one, squares of a long one, and what lies around a region never."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from tests.fit.space.scenes import capture_of
from tests.helpers.motion_temporal import moving_pictures
from tg4mm.capture.window import Window
from tg4mm.core.errors import Tg4mmError
from tg4mm.fit.motion.config import MotionConfig, checked
from tg4mm.fit.motion.observations import observe
from tg4mm.fit.motion.reduction import note_on, window_on


def filmed(n, height, width):
    data, _, _ = moving_pictures(1, n)
    capture, images = capture_of([0] * n, list(range(n)), data)
    return replace(capture, height=height, width=width), images


@pytest.mark.parametrize(
    ("n", "size", "factor"),
    [(600, (720, 1280), 1), (600, (1080, 1920), 2), (600, (2160, 3840), 3), (60, (2160, 3840), 2)],
)
def test_a_long_recording_of_large_pictures_is_read_smaller(n, size, factor):
    capture, _ = filmed(n, *size)
    window = window_on(capture, MotionConfig())
    assert (1 if window is None else window.factor) == factor
    assert window_on(capture, MotionConfig(reduce="1")) is None
    assert window_on(capture, MotionConfig(reduce="4")).size == (size[0] // 4, size[1] // 4)


def test_a_region_is_read_whole_with_what_lies_around():
    capture, _ = filmed(600, 2160, 3840)
    moves = np.zeros((2160, 3840), bool)
    moves[400:900, 900:1500] = True
    window = window_on(capture, MotionConfig(), moves)
    assert (window.factor, window.size, window.top, window.left) == (1, (1100, 1200), 100, 600)


@pytest.mark.parametrize("text", ["0", "1.5", "-2", "17", "two"])
def test_what_is_no_factor_is_refused(text):
    with pytest.raises(Tg4mmError, match=r"motion.reduce is .* whole number, 1 to 16"):
        checked(MotionConfig(reduce=text))


def test_rows_of_a_region_keep_their_times():
    capture, images = filmed(20, 4, 5)
    capture = replace(capture, readout_s=0.02, kind="flat")
    whole, part = (observe(capture, images, w).frames[0] for w in (None, Window(2, 0, 2, 5, 1)))
    row = 3  # of the picture, the second of the region
    of_whole = whole.times_s + whole.readout_s * ((row + 0.5) / 4 - 0.5)
    of_part = part.times_s + part.readout_s * ((row - 2 + 0.5) / 2 - 0.5)
    assert np.allclose(of_whole, of_part)


@pytest.mark.parametrize(("fineness", "loss"), [(8.0, 1.0), (1.0, 4.0)])
def test_what_averaging_costs_is_told_by_the_texture(fineness, loss):
    """Coarse texture loses nothing; of white noise a sixteenth of the slopes' squares stays."""
    rng = np.random.default_rng(0)
    n, height, width = 12, 160, 160
    cells = rng.uniform(60, 190, (int(height / fineness) + 2, int(width / fineness) + 2))
    y, x = (np.arange(s) / fineness for s in (height, width))
    rest = map_coordinates(
        cells, np.meshgrid(y, x, indexing="ij"), order=3 if fineness > 1 else 0, mode="nearest"
    )
    data = np.full((n, height, width, 4), 255, np.uint8)
    data[..., :3] = (rest[None, ..., None] + rng.normal(0, 4, (n, height, width, 3))).round().clip(0, 255)
    capture, images = capture_of([0] * n, list(range(n)), data)
    note = note_on(capture, images, window_on(capture, MotionConfig(reduce="2")))
    told = float(note.split("about ")[1].split(" times")[0])
    assert told == pytest.approx(loss, rel=0.15)
