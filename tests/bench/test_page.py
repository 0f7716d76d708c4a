"""The HTML page stands alone and works in a browser; tables are whole in LaTeX."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.view.browser import browser
from tg4mm.bench.html import write_page
from tg4mm.bench.latex import escaped, latex_table
from tg4mm.bench.methods.external import External
from tg4mm.bench.scenes import ScenesRequest, run_scenes
from tg4mm.bench.tables import Table


@pytest.fixture(scope="module")
def made(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A benchmark of methods without training."""
    folder = tmp_path_factory.mktemp("page")
    shutil.copytree(data, folder / "theirs" / data.name)
    request = ScenesRequest(("linear-2d", "phase-2d"), external=(External("theirs", folder / "theirs"),))
    run_scenes([data], folder / "out", request, lambda text: None)
    return folder / "out"


def test_the_page_loads_nothing(made: Path) -> None:
    page = (made / "results.html").read_text(encoding="utf-8")
    assert not re.findall(r"(?:src|href)=\"(?!data:|#)[^\"]*\"", page)
    assert page.count("<video") == 4  # the ground truth and three methods
    assert page.count('class="compare"') == 1


def test_it_can_be_written_again_from_what_is_on_disk(made: Path) -> None:
    before = (made / "results.html").read_bytes()
    write_page(made, json.loads((made / "results.json").read_text(encoding="utf-8")))
    after = (made / "results.html").read_bytes()
    assert re.sub(rb"data:video/mp4;base64,[^\"]*", b"", after) == re.sub(
        rb"data:video/mp4;base64,[^\"]*", b"", before
    )


def test_in_a_browser(made: Path) -> None:
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
        before = left.get_attribute("src")
        page.locator('.compare select[data-pick="left"]').select_option(label="linear-2d")
        assert left.get_attribute("src") != before
        assert not errors


def test_latex_prints_what_the_cells_hold() -> None:
    text = latex_table(Table("x", "A_b", "50 % & more", ["set", "α"], [["mic_5Hz", "0.9"]]), "128×128")
    assert r"\toprule" in text
    assert r"mic\_5Hz & 0.9 \\" in text
    assert r"50 \% \& more" in text
    assert r"128$\times$128" in text
    assert text.count("{") == text.count("}")
    assert escaped("a\\b") == r"a\textbackslash{}b"
