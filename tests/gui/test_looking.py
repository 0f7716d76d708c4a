"""The checks on screenshots, given pictures that must fail them; needs no Blender."""

from __future__ import annotations

import numpy as np

from . import looking
from .conftest import drum
from .session import Box, read_xwd


def test_black_and_plain_pictures_are_blank_and_a_busy_one_is_not() -> None:
    busy = np.random.default_rng(0).integers(0, 256, (40, 60, 3), dtype=np.uint8)
    assert looking.is_blank(np.zeros((40, 60, 3), np.uint8))
    assert looking.is_blank(np.full((40, 60, 3), 61, np.uint8))
    assert looking.is_blank(busy[:0])
    assert not looking.is_blank(busy)


def test_changed_counts_the_pixels_that_differ() -> None:
    a = np.full((10, 10, 3), 100, np.uint8)
    b = a.copy()
    b[:5, :, 1] = 200
    assert looking.changed(a, a) == 0.0
    assert looking.changed(a, a + 5) == 0.0  # less than what counts
    assert looking.changed(a, b) == 0.5


def test_grey_is_not_a_colour() -> None:
    picture = np.full((4, 4, 3), 180, np.uint8)
    assert looking.coloured(picture) == 0.0
    picture[0, :, 2] = 20
    assert looking.coloured(picture) == 0.25


def test_a_box_cuts_rows_from_the_top() -> None:
    picture = np.zeros((8, 10, 3), np.uint8)
    picture[2:4, 3:7] = 255
    assert looking.cut(picture, Box(3, 2, 4, 2)).min() == 255
    assert looking.cut(picture, Box(3, 2, 4, 2)).shape == (2, 4, 3)


def test_the_drum_moves_where_it_should() -> None:
    """What the tests in Blender compare with is worth it: the drum is not still, and its rim is."""
    splat = drum()
    rim = np.abs(splat.means[:, :2]).max(axis=1) > 0.999
    amplitude = np.abs(splat.displacement).max(axis=(0, 2))
    assert amplitude.max() > 0.015
    assert amplitude[rim].max() < 1e-6


def test_a_screen_of_xvfb_is_read() -> None:
    """A dump as X11/XWDFile.h has it: 25 numbers, a name, a palette of 12 bytes an entry, rows with a rest."""
    header = np.zeros(25, ">u4")
    header[[0, 4, 5, 11, 12, 19]] = 104, 2, 1, 32, 12, 3
    pixels = bytes([1, 2, 3, 0, 4, 5, 6, 0, 9, 9, 9, 9])
    shown = read_xwd(header.tobytes() + b"Xvf\0" + bytes(36) + pixels)
    np.testing.assert_array_equal(shown, [[[3, 2, 1], [6, 5, 4]]])
