"""The HTML page stands alone and works in a browser; tables are whole in LaTeX."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.show.view.browser import browser
from tg4mm.research.bench.methods.external import External
from tg4mm.research.bench.pages.markdown import how
from tg4mm.research.bench.pages.tables import full_table, groups_of, tables_of
from tg4mm.research.bench.pages.text import Table, escaped, latex_table
from tg4mm.research.bench.pages.write import write_page
from tg4mm.research.bench.scenes import ScenesRequest, run_scenes


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
        at = (
            "e => parseFloat(getComputedStyle(e.parentElement, '::after').left) / e.parentElement.clientWidth"
        )
        assert left.evaluate(at) == pytest.approx(0.2, abs=0.01)
        before = left.get_attribute("src")
        page.locator('.compare select[data-pick="left"]').select_option(label="linear-2d")
        assert left.get_attribute("src") != before
        assert not errors


def test_figures_of_a_paper_are_files_too(made: Path, data: Path) -> None:
    """[TG4MM] Fig. 3 and 4: a picture for the ground truth and each of the three methods."""
    sizes = {}
    for kind in ("slices", "differences"):
        with Image.open(made / "figures" / f"{data.name}_{kind}.png") as sheet:
            sizes[kind] = sheet.size
            assert len(np.unique(np.asarray(sheet).reshape(-1, 3), axis=0)) > 10
    assert sizes["slices"] == (720, 4 * (96 + 22) + 4)
    assert sizes["differences"] == (720, 4 * (720 // 5 + 22) + 4)  # five maps side by side, of six timesteps


def test_every_table_is_there_in_latex(made: Path) -> None:
    results = json.loads((made / "results.json").read_text())
    (group,) = groups_of(results)
    for table in (*tables_of(results, group), full_table(results, group)):
        text = (made / "tables" / f"1_{table.key}.tex").read_text(encoding="utf-8")
        assert text.count(r"\\") == len(table.rows) + 1


def test_a_table_longer_than_a_page_goes_on_on_the_next() -> None:
    text = latex_table(Table("x", "A", "B", ["set", "α"], [["mic", str(i)] for i in range(100)]))
    assert text.startswith(r"\begin{longtable}{lr}")
    assert text.count(r"\\") == 102  # the caption too
    assert r"\caption{A. B}" in text


def test_latex_prints_what_the_cells_hold() -> None:
    text = latex_table(Table("x", "A_b", "50 % & more", ["set", "α"], [["mic_5Hz", "0.9"]]), "128×128")
    assert r"\toprule" in text
    assert r"mic\_5Hz & 0.9 \\" in text
    assert r"50 \% \& more" in text
    assert r"128$\times$128" in text
    assert text.count("{") == text.count("}")
    assert escaped("a\\b") == r"a\textbackslash{}b"


def test_it_speaks_of_methods_that_are_there() -> None:
    """Times are matched for the paper's presets; the 2D methods see what others do not."""

    def words(*methods: str) -> tuple[bool, bool]:
        said = how({"band": True, "same_time": "needed", "methods": list(methods), "lines": []})
        return "trained once more" in said, "2d" in said

    assert words("modal") == (False, False)
    assert words("modal", "paper-tuned") == (True, False)
    assert words("modal", "phase-2d") == (False, True)
    assert words("modal", "papers", "ours-2d") == (False, False)  # made elsewhere
