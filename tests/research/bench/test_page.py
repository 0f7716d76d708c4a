"""The HTML page stands alone and works in a browser; its tables sort."""

import re
import shutil
from typing import Any

import pytest

from tests.show.view.browser import browser
from tg4mm.research.bench.methods.known import External
from tg4mm.research.bench.scenes import ScenesRequest, run_scenes


@pytest.fixture(scope="module")
def made(data, tmp_path_factory):
    """A benchmark of methods without training."""
    folder = tmp_path_factory.mktemp("page")
    shutil.copytree(data, folder / "theirs" / data.name)
    request = ScenesRequest(("linear-2d", "phase-2d"), external=(External("theirs", folder / "theirs"),))
    run_scenes([data], folder / "out", request, lambda text: None)
    return folder / "out"


def test_the_page_loads_nothing(made):
    page = (made / "results.html").read_text(encoding="utf-8")
    assert not re.findall(r"(?:src|href)=\"(?!data:|#)[^\"]*\"", page)
    assert page.count("<video") == 4  # the ground truth and three methods
    assert page.count('class="compare"') == 1


def test_in_a_browser(made):
    with browser() as opened:
        page = opened.new_page()
        errors: list[Any] = []
        page.on("pageerror", lambda error: errors.append(error))
        page.goto((made / "results.html").as_uri())
        table = "figure.table:has(figcaption:has-text('Every set'))"
        column = f"{table} tbody td:nth-child(4)"
        shown = [float(x) for x in page.locator(column).all_inner_texts()]
        page.click(f"{table} th:nth-child(4)")
        assert [float(x) for x in page.locator(column).all_inner_texts()] == sorted(shown)
        page.click(f"{table} th:nth-child(4)")
        assert [float(x) for x in page.locator(column).all_inner_texts()] == sorted(shown, reverse=True)
        left = page.locator('.compare img[data-side="left"]')
        page.locator(".compare [data-edge]").fill("20")
        assert "80%" in left.evaluate("e => e.style.clipPath")
        at = (
            "e => parseFloat(getComputedStyle(e.parentElement, '::after').left) / e.parentElement.clientWidth"
        )
        assert left.evaluate(at) == pytest.approx(0.2, abs=0.01)
        before = left.get_attribute("src")
        page.locator('.compare select[data-pick="left"]').select_option(label="linear-2d")
        assert left.get_attribute("src") != before
        assert not errors
