"""Pictures from known numbers."""

import numpy as np
import pytest

from tg4mm.core.colour import amount_colours
from tg4mm.show.report.figures import (
    MARK,
    Line,
    contact_sheet,
    line_that_moves,
    map_picture,
    marked,
    phase_picture,
    slice_picture,
)


def moving_dot(axis: str) -> np.ndarray:
    """A dot that moves along column 20 (or row 20) between pixels 10 and 14 of 40."""
    video = np.ones((8, 40, 40, 3))
    for t in range(8):
        place = 10 + t % 5
        video[(t, place, 20) if axis == "column" else (t, 20, place)] = 0
    return video


@pytest.mark.parametrize("axis", ["row", "column"])
def test_the_line_follows_the_motion(axis):
    line = line_that_moves(moving_dot(axis), margin=0.1)
    assert (line.axis, line.index) == (axis, 20)
    assert (line.start, line.stop) == (6, 19)


def test_a_video_without_motion_still_has_a_line():
    line = line_that_moves(np.ones((4, 10, 12, 3)))
    assert line.start == 0
    assert line.stop in {10, 12}


@pytest.mark.parametrize("axis", ["row", "column"])
def test_slices_hold_the_line_over_time(axis):
    video = (moving_dot(axis) * 255).astype(np.uint8)
    picture = slice_picture(video, Line(axis, 20, 6, 19), periods=2)
    over_time = picture if axis == "row" else picture.transpose(1, 0, 2)
    assert over_time.shape == (16, 13, 3)
    assert [int(row[:, 0].argmin()) + 6 for row in over_time] == [10 + t % 5 for t in range(8)] * 2


def test_the_mark_lies_on_the_line():
    picture = marked(np.full((50, 50, 3), 255, np.uint8), Line("column", 10, 5, 40), edge=500)
    assert picture.shape == (500, 500, 3)
    np.testing.assert_array_equal(picture[200, 105], MARK)
    np.testing.assert_array_equal(picture[200, 300], 255)
    np.testing.assert_array_equal(picture[450, 105], 255)


def test_a_contact_sheet_keeps_order_and_leaves_gaps_clear():
    images = [np.full((8, 8, 3), 50 * i, np.uint8) for i in range(5)]
    sheet = contact_sheet(images, columns=3, gap=2, edge=8)
    assert sheet.shape == (18, 28, 4)
    assert sheet[4, 14, 0] == 50
    assert sheet[14, 4, 0] == 150
    assert sheet[4, 9, 3] == 0
    assert sheet[14, 24, 3] == 0


def test_an_empty_contact_sheet_is_an_error():
    with pytest.raises(ValueError, match="at least one"):
        contact_sheet([], columns=3)


def test_amounts_become_the_colours_of_the_scale():
    picture = map_picture(np.array([[0.0, 1.0, 2.0]]), 2.0, np.array([[1.0, 1.0, 0.0]]))
    expected = np.round(amount_colours(np.array([0.0, 0.5, 1.0])) * 255)
    np.testing.assert_allclose(picture[0, :, :3], expected, atol=1)
    np.testing.assert_array_equal(picture[0, :, 3], [255, 255, 0])


def test_a_map_of_nothing_is_all_zero_colour():
    picture = map_picture(np.zeros((2, 2)), 0.0)
    assert len(np.unique(picture.reshape(-1, 4), axis=0)) == 1


def test_phase_fades_to_grey_where_nothing_moves():
    picture = phase_picture(np.array([[1.0, 1.0]]), np.array([[0.0, 1.0]]), np.ones((1, 2)))
    assert len(set(picture[0, 0, :3].tolist())) == 1
    assert len(set(picture[0, 1, :3].tolist())) > 1
