"""The page's script in a browser: videos of a figure run in step, and its buttons and slider move all of them."""

import time
from typing import Any

import numpy as np
import pytest

from tests.show.view.browser import browser
from tg4mm.core.pages.page import Figure, Page, Section, film, render_page
from tg4mm.show.report.figures import clip

SECONDS = 4.0  # of each video, twice over what is shown
RECORD = 2.0
VIDEOS = "[...document.querySelectorAll('video')]"


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    frames = np.zeros((60, 32, 32, 3), np.uint8)
    frames[:, :, :16] = np.arange(60, dtype=np.uint8)[:, None, None, None] * 4
    films = [film(clip(frames, 30.0, SECONDS), frames[0], name) for name in ("left", "right")]
    figure = Figure(films, "Two videos.", 2, controls=True, seconds=RECORD)
    page = Page("Title", "kicker", "", [], [], [Section("Section", [figure])], "")
    path = tmp_path_factory.mktemp("sync") / "page.html"
    path.write_text(render_page(page), encoding="utf-8")
    return path


def until(page, what):
    """Asked again and again: the page's policy lets nothing in it evaluate text, so it cannot ask itself."""
    deadline = time.monotonic() + 30
    while not page.evaluate(what):
        assert time.monotonic() < deadline, what
        page.wait_for_timeout(20)


@pytest.fixture(scope="module")
def chromium():
    with browser() as opened:
        yield opened


@pytest.fixture
def page(file, chromium):
    opened = chromium.new_page()
    errors: list[Any] = []
    opened.on("pageerror", lambda error: errors.append(error))
    opened.goto(file.as_uri())
    until(opened, f"{VIDEOS}.every(v => v.readyState >= 3 && v.currentTime > 0)")
    yield opened
    opened.close()
    assert not errors


def of_videos(page, name):
    return list(page.evaluate(f"{VIDEOS}.map(v => v.{name})"))


def test_the_button_pauses_and_starts_all(page):
    button = page.locator("[data-play]")
    assert button.inner_text() == "Pause"
    button.click()
    assert of_videos(page, "paused") == [True, True]
    until(page, "document.querySelector('[data-play]').textContent == 'Play'")
    button.click()
    until(page, f"{VIDEOS}.every(v => !v.paused)")
    until(page, "document.querySelector('[data-play]').textContent == 'Pause'")


def test_the_slider_takes_all_to_a_time_of_the_record(page):
    page.locator("[data-seek]").fill("1.5")
    assert of_videos(page, "paused") == [True, True]
    assert of_videos(page, "currentTime") == pytest.approx([1.5, 1.5])
    assert page.locator(".time").inner_text() == "1.50 s"
    page.locator("[data-seek]").fill(str(RECORD))  # not the first picture of the next round
    assert max(of_videos(page, "currentTime")) < RECORD
