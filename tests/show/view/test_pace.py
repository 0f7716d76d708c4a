"""Pictures get as many pixels as keep up with the frame rate, and the canvas' shape."""

import pytest

from tg4mm.show.view.screen import RATE, Pace, full_size


def settled(seconds_per_pixel: float, canvas: tuple[int, int], rounds: int = 60) -> tuple[int, int]:
    pace = Pace()
    for _ in range(rounds):
        width, height = pace.size(*canvas)
        pace = pace.after(width * height * seconds_per_pixel, width * height)
    return pace.size(*canvas)


def test_a_fast_machine_draws_the_canvas_as_it_is():
    assert settled(1e-9, (1280, 900)) == (1280, 900)


def test_a_slow_machine_keeps_the_rate_with_fewer_pixels():
    per_pixel = 8e-8
    width, height = settled(per_pixel, (1280, 900))
    assert width * height * per_pixel == pytest.approx(0.7 / RATE, rel=0.3)
    assert width / height == pytest.approx(1280 / 900, rel=0.01)


def test_it_is_never_too_coarse_to_see_anything():
    assert settled(1.0, (1280, 900)) == (512, 360)


def test_a_huge_canvas_is_held_to_what_can_be_drawn():
    assert full_size(4800, 2400) == (2400, 1200)
    assert full_size(640, 480) == (640, 480)
