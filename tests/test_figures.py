"""README's figures and those of docs/results.md are one generated table."""

import json

import pytest

from benchmarks.figures import FILE, PAGES, figures_of, filled, tables


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_prints_the_figures_of_the_file(page):
    text, figures = page.read_text(encoding="utf-8"), json.loads(FILE.read_text(encoding="utf-8"))
    assert "<!-- figures: " in text
    assert filled(text, tables(figures)) == text
    figures["scenes"]["mic"]["displacement_error"] += 0.1  # in every table but that of SSIM
    assert filled(text, tables(figures)) != text


def test_figures_are_those_of_a_benchmarks_results():
    run = {
        "set": "mic_5Hz_0_005", "row": "modal", "log": {}, "n_gaussians": 9, "mib_on_disk": 1.0,
        "displacement": {"relative_error": 0.04, "static_leak": 0.01, "per_frequency": []},
        "seconds": {"space": 1.0, "motion": 1.0, "total": 2.0},
    }  # fmt: skip
    means = [{"row": row, "alphas": {"20": {"ssim": 0.9}}} for row in ("nothing moves", "modal", "ceiling")]
    found = figures_of({"runs": [run], "line_means": means})
    assert found["scenes"]["mic"]["displacement_error"] == 0.04
    assert found["ssim"]["ceiling"] == {"20": 0.9}
