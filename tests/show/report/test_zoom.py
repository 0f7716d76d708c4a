"""Charts that zoom: their numbers are those of the drawing, and a drag, a double click and buttons move them."""

import json
import re

import numpy as np
import pytest

from tests.show.report.page_checks import check
from tests.show.report.test_sync import until
from tests.show.view.browser import browser
from tg4mm.core.errors import RunError
from tg4mm.core.pages.charts import chart
from tg4mm.core.pages.page import Figure, Page, Section, drawing, render_page
from tg4mm.show.report import write as pdf

X = np.linspace(0, 10, 101)
SPAN = "(() => { const s = window.plots[%d].scales; return [s.x.min, s.x.max, s.y.min, s.y.max]; })()"


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


def test_a_drag_zooms_and_a_double_click_shows_all(html, tmp_path):
    path = tmp_path / "page.html"
    told = "window.plots = []; const U = uPlot; uPlot = (...a) => plots[plots.push(new U(...a)) - 1];"
    assert "new uPlot(" in html
    kept = html.replace("new uPlot(", "uPlot(").replace(
        "// A chart that has", f"{told}\n// A chart that has", 1
    )
    path.write_text(kept, encoding="utf-8")
    with browser() as chromium:
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


def test_a_page_is_printed_or_it_is_said_what_prints(html, tmp_path, monkeypatch):
    path = tmp_path / "page.html"
    path.write_text(html, encoding="utf-8")
    with browser():  # is there
        pass
    made = pdf.print_pdf(path, pdf.printer())
    assert made.read_bytes().startswith(b"%PDF")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["page.html", "page.pdf"]
    with pytest.raises(RunError, match="did not print"):
        pdf.print_pdf(path, "false")
    monkeypatch.setattr(pdf.shutil, "which", lambda _: None)
    monkeypatch.setattr(pdf, "_of_playwright", lambda: None)
    with pytest.raises(RunError, match=r'no Chromium, Chrome or Edge .* pip install "tg4mm\[pdf\]"'):
        pdf.printer()
