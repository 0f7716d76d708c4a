"""A dataset's report as a page: sound, the same each time, and what is absent is said."""

import json

import pytest

pytest.importorskip("jinja2", reason="the report needs jinja2")
pytest.importorskip("skimage", reason="the report needs scikit-image")

from PIL import Image

from dataset_gen.report import write_overview, write_report
from dataset_gen.report.__main__ import main
from tests.dataset_gen.planes import Plane
from tests.show.report.page_checks import check, read_page, words


def test_the_page_is_sound_and_says_the_numbers(page, plane):
    check(page)
    said = words(page)
    for title in (
        "The pictures",
        "How it moves",
        "Motion in pixels",
        "What a perfect method would score",
        "How it was made",
    ):
        assert title in said
    assert "3 Hz and 6 Hz" in said
    assert "0.02 units (2 mm)" in said
    assert "square (100 %)" in said
    assert "per-pixel truth" in said
    assert "vertices" in said
    found = json.loads((plane / "report/summary.json").read_text())
    assert f"{found['scores'][-1]['perfect_psnr_db']:.2f}" in said
    assert Image.open(plane / "report/contact_sheet.png").width > 4 * 168
    assert not list((plane / "report").glob(".*"))


def test_what_is_absent_is_said(tmp_path):
    made = Plane(tmp_path / "a")
    made.write(alphas=(), test=False)
    (made.root / "truth/motion.npz").unlink()
    text = write_report(made.root).read_text()
    check(text)
    said = words(text)
    assert "Ground truth of magnified motion is absent" in said
    assert "truth/motion.npz is absent" in said
    assert "no test views" in said
    assert "Neither per-pixel truth nor truth/motion.npz" in said
    assert "Scale unknown" in said
    assert "not recorded" in said


def test_the_overview_links_every_report_and_names_what_has_none(plane, page):
    parent = plane.parent
    (parent / "unfinished").mkdir(exist_ok=True)
    (parent / "unfinished/scene.json").write_text("{}")
    text = write_overview(parent).read_text(encoding="utf-8")
    reader = read_page(text)
    assert not reader.errors
    links = {load for load in reader.loads if not load.startswith("data:")}
    assert links == {"plane_3Hz_0_02/report/index.html"}
    assert (parent / links.pop()).is_file()
    said = words(text)
    assert "Without a report that can be read: unfinished" in said
    found = json.loads((plane / "report/summary.json").read_text())
    assert f"{found['scores'][-1]['perfect_psnr_db']:.2f}" in said
    assert "2 datasets" in said


def test_a_hostile_name_stays_text(tmp_path):
    evil = "<script>alert(1)</script>"
    made = Plane(tmp_path / "sets" / "a&b")
    made.write(modes=[{"name": evil, "kind": evil}], engine={evil: evil}, **{"scene": evil})
    for text in (write_report(made.root).read_text(), write_overview(made.root.parent).read_text()):
        reader = read_page(text)
        assert not reader.errors
        assert reader.tags.count("script") == 1


def test_the_command_writes_reports_and_an_overview(plane, capsys):
    assert main([str(plane), "--overview", str(plane.parent)]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out == [str(plane / "report/index.html"), str(plane.parent / "index.html")]
    assert main([str(plane / "nothing")]) == 2
    assert capsys.readouterr().err.startswith("error: ")
