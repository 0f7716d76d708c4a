"""Pages in a browser: videos in step with their buttons and slider, charts that zoom, and PDF."""

import json
import re
import time
from typing import Any

import numpy as np
import pytest

from tests.show.report.page_checks import check
from tests.show.view.browser import browser
from tg4mm.core.errors import RunError
from tg4mm.core.pages.charts import chart
from tg4mm.core.pages.page import Figure, Page, Section, drawing, film, render_page
from tg4mm.show.report import write as pdf
from tg4mm.show.report.figures import clip

SECONDS = 4.0  # of each video, twice over what is shown
RECORD = 2.0
VIDEOS = "[...document.querySelectorAll('video')]"
X = np.linspace(0, 10, 101)
SPAN = "(() => { const s = window.plots[%d].scales; return [s.x.min, s.x.max, s.y.min, s.y.max]; })()"


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


def waves(axes):
    axes.semilogy(X, 2 + np.sin(X), color="#0072b2", label="right </script>")
    axes.fill_between(X, 1.5 + np.sin(X), 2.5 + np.sin(X), color="#0072b2", alpha=0.2)
    axes.semilogy(X[::10], np.full(11, 0.7), color="#d55e00", ls="--")
    axes.axhline(0.6, color="#777777")
    axes.annotate("3 Hz", (3.0, 2.0))
    axes.set(xlabel="time, s", ylabel="mm", xlim=(0, 10), ylim=(0.5, 4))


def fall(axes):
    axes.pcolormesh(X[:4], X[:3], np.array([[-60.0, -30, 0, 0], [0] * 4, [-60] * 4]), vmin=-60, vmax=0)


@pytest.fixture(scope="module")
def html():
    panels = [drawing(chart(draw, "waves", zooms=True)) for draw in (waves, fall)]
    return render_page(Page("T", "k", "", [], [], [Section("S", [Figure(panels, "c")])], ""))


def test_the_numbers_are_those_of_the_drawing(html):
    check(html)
    found, mesh = (json.loads(t) for t in re.findall(r'class="curves">(.*?)</script>', html, re.S))
    own, floor = found["series"]
    assert own["name"] == "right </script>"
    np.testing.assert_allclose(own["y"], 2 + np.sin(X), rtol=1e-5)
    np.testing.assert_allclose(np.subtract(own["high"], own["low"]), 1, rtol=1e-4)
    assert [v for v in floor["y"] if v is not None] == [0.7] * 11
    assert (floor["dash"], found["across"][0][0], found["marks"]) == (True, 0.6, [[3.0, 2.0, "3 Hz"]])
    assert (found["xRange"], found["yRange"], found["log"]) == ([0, 10], [0.5, 4], True)
    assert mesh["levels"][0]["steps"][0] == [0, 16, 31, 31]
    assert render_page(Page("T", "k", "", [], [], [], "")).count("uPlot") == 0


def test_a_drag_zooms_and_a_double_click_shows_all(html, chromium, tmp_path):
    path = tmp_path / "page.html"
    recorder = "window.plots = []; const U = uPlot; uPlot = (...a) => plots[plots.push(new U(...a)) - 1];"
    assert "new uPlot(" in html
    own = html.replace("new uPlot(", "uPlot(")
    path.write_text(own.replace("// A chart that has", f"{recorder}\n// A chart", 1), encoding="utf-8")
    page = chromium.new_page(viewport={"width": 390, "height": 800})
    errors: list[object] = []
    page.on("pageerror", lambda error: errors.append(error))
    page.goto(path.as_uri())
    until(page, "document.querySelectorAll('.zoomed .uplot').length == 2")
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    box = page.locator(".u-over").first.bounding_box()
    page.mouse.move(box["x"] + 0.2 * box["width"], box["y"] + 60)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 62, steps=4)
    page.mouse.up()
    until(page, f"{SPAN % 0}[1] < 7")
    assert page.evaluate(SPAN % 0) == pytest.approx([2, 6, 0.5, 4], abs=0.1)
    page.mouse.dblclick(box["x"] + 50, box["y"] + 50)
    until(page, f"{SPAN % 0}[1] > 9")
    page.locator(".zooms button").first.click()
    until(page, f"{SPAN % 0}[0] > 2")
    assert page.evaluate(SPAN % 0) == pytest.approx([2.5, 7.5, 0.5, 4])
    place = page.locator(".u-over").nth(1)
    place.scroll_into_view_if_needed()
    place.hover()
    until(page, "document.querySelectorAll('.zooms output')[1].textContent.endsWith('dB')")
    assert not errors
    page.close()


def test_a_page_is_printed_or_it_is_said_what_prints(html, chromium, tmp_path, monkeypatch):
    path = tmp_path / "page.html"
    path.write_text(html, encoding="utf-8")
    made = pdf.print_pdf(path, pdf.printer())
    assert made.read_bytes().startswith(b"%PDF")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["page.html", "page.pdf"]
    with pytest.raises(RunError, match="failed to print"):
        pdf.print_pdf(path, "false")
    monkeypatch.setattr(pdf.shutil, "which", lambda _: None)
    monkeypatch.setattr(pdf, "_of_playwright", lambda: None)
    with pytest.raises(RunError, match=r'no Chromium, Chrome or Edge .* pip install "tg4mm\[pdf\]"'):
        pdf.printer()
