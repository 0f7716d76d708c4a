"""Playing time runs at its speed, and goes on from where it was when something changes."""

import pytest

from tg4mm.show.view.session import Clock, slow_enough


def test_it_plays_at_its_speed_and_starts_anew_at_the_end():
    clock = Clock(2.0, since=100.0, speed=0.5, playing=True)
    assert clock.at(101.0) == pytest.approx(0.5)
    assert clock.at(105.0) == pytest.approx(0.5)  # 2.5 s of a capture of 2 s


def test_without_loop_it_stays_at_the_end_and_plays_again_from_the_start():
    clock = Clock(2.0, since=100.0, playing=True, loop=False)
    assert clock.at(110.0) == 2.0
    assert not clock.running(110.0)
    again = clock.changed(110.0, playing=True)
    assert again.at(110.5) == pytest.approx(0.5)


def test_a_pause_holds_the_moment():
    clock = Clock(2.0, since=0.0, playing=True).changed(0.7, playing=False)
    assert clock.at(5.0) == pytest.approx(0.7)
    assert clock.changed(6.0, playing=True).at(6.2) == pytest.approx(0.9)


def test_another_speed_changes_nothing_at_that_moment():
    clock = Clock(2.0, playing=True)
    assert clock.changed(0.8, speed=0.1).at(0.8) == pytest.approx(0.8)
    assert clock.changed(0.8, speed=0.1).at(1.8) == pytest.approx(0.9)


def test_seeking_stays_within_the_capture():
    clock = Clock(2.0)
    assert clock.sought(3.0, -1.0).at(3.0) == 0.0
    assert clock.sought(3.0, 9.0).at(3.0) == 2.0


def test_a_scene_at_rest_has_no_time():
    assert Clock(0.0, playing=True).at(3.0) == 0.0
    assert not Clock(0.0, playing=True).running(3.0)


@pytest.mark.parametrize(
    ("frequency", "speed"), [(0.5, 1.0), (3.0, 1.0), (5.0, 0.5), (100.0, 0.02), (1e4, 0.01)]
)
def test_fast_motion_starts_in_slow_motion(frequency, speed):
    assert slow_enough(frequency) == speed
