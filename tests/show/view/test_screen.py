"""A page gets a picture when something changed, one at full size when all is still, and none after that."""

import numpy as np
import pytest

from tg4mm.core.magnification import Magnification
from tg4mm.run import Run
from tg4mm.show.view.painter import Look
from tg4mm.show.view.scene import open_scene
from tg4mm.show.view.screen import Canvas, Pace, Screen
from tg4mm.show.view.session import Clock, Session

CANVAS = Canvas((0.0, -4.0, 0.5), (0.7071068, -0.7071068, 0.0, 0.0), 0.7, 320, 240)


@pytest.fixture
def sent():
    return []


@pytest.fixture
def session(scene):
    return Session(scene, Look(Magnification.of(20.0)), Clock(scene.duration))


@pytest.fixture
def screen(session, sent):
    screen = Screen(session, lambda picture, quality: sent.append((picture, quality)))
    screen._pace = Pace(pixels=100.0 * 100)  # as on a slow machine
    return screen


def test_a_still_page_is_drawn_twice_and_then_left_alone(screen, sent):
    assert [screen.refresh(CANVAS, t) for t in (0.0, 0.1, 0.2, 0.3)] == [True, True, False, False]
    assert sent[0][0].shape[0] < 240
    assert sent[1][0].shape == (240, 320, 3)
    assert sent[1][1] > sent[0][1]


def test_every_change_is_shown(screen, session, sent):
    screen.refresh(CANVAS, 0.0)
    screen.refresh(CANVAS, 0.0)
    session.magnify(-1.0)
    assert session.changed.is_set()
    assert screen.refresh(CANVAS, 0.0)
    session.set_clock(lambda clock, now: clock.sought(now, 0.1))
    assert screen.refresh(CANVAS, 0.0)
    moved = Canvas((0.0, -3.0, 0.5), CANVAS.wxyz, CANVAS.fov, 320, 240)
    assert screen.refresh(moved, 0.0)
    assert len({picture.tobytes() for picture, _ in sent}) >= 4


def test_playing_draws_again_and_again(screen, session, sent):
    session.set_clock(lambda clock, now: Clock(clock.duration, since=0.0, playing=True))
    assert all(screen.refresh(CANVAS, 0.03 * i) for i in range(4))
    assert np.abs(sent[0][0].astype(int).mean() - 255) > 0.5  # something is in view


def test_a_run_without_frequencies_is_shown_and_says_so(run, tmp_path, sent):
    made = Run.create(tmp_path / "run", run.dataset, "modal", {})
    made.save_space(run.load_space(), {})
    made.save_motion(run.load_motion().selected(np.zeros(2, bool)), {})
    opened = open_scene(made)
    assert opened.notes == ("No frequency was found in this run: there is nothing to magnify.",)
    assert opened.duration == 0
    assert opened.alpha_to_see() == 0
    session = Session(opened, Look(Magnification.of(20.0)), Clock(opened.duration, playing=True))
    screen = Screen(session, lambda picture, quality: sent.append(picture))
    assert screen.refresh(CANVAS, 0.0)
    assert sent[0].min() < 200


def test_a_session_at_rest_stays_still(still_run, sent):
    session = Session(open_scene(still_run), Look(), Clock(0.0, playing=True))
    screen = Screen(session, lambda picture, quality: sent.append(picture))
    assert [screen.refresh(CANVAS, t) for t in (0.0, 1.0, 2.0)] == [True, True, False]
