"""Ablations: rows differ in what they say they vary and in nothing else, and their tables hold evaluate's numbers."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dataset_gen.options import parser, request_from
from tests.research.bench.conftest import MODAL, PAPER
from tg4mm.cli import main
from tg4mm.core.filters import TemporalFilter
from tg4mm.core.pages.page import Figure
from tg4mm.research.bench.ablation.catalogue import ABLATIONS, rows_of
from tg4mm.research.bench.ablation.page import (
    COLUMNS,
    ablation_cells,
    ablation_table,
    mean_lines,
    read_ablation,
)
from tg4mm.research.bench.ablation.run import run_ablation
from tg4mm.research.bench.ablation.sets import KINDS
from tg4mm.research.bench.pages.write import _ablation
from tg4mm.research.bench.request import Plan, check_settings, setting_names
from tg4mm.research.bench.sets import open_set
from tg4mm.research.evaluate.run import CEILING, STATIC


def every():
    return [(name, preset) for name, ablation in ABLATIONS.items() for preset in ablation.presets]


def silent(_):
    """No messages."""


def lines_of(out):
    return json.loads((out / "results.json").read_text(encoding="utf-8"))["lines"]


@pytest.mark.parametrize(("name", "preset"), every())
def test_every_row_can_be_trained_and_no_two_are_the_same(name, preset):
    rows = rows_of(name, preset, {})
    assert len(rows) >= 2
    for row in rows:
        assert set(row.settings) <= setting_names(preset)
        check_settings(row.settings, preset)
    kinds = {(json.dumps([dict(r.settings), *r.changed_data]), r.scorings) for r in rows}
    assert len(kinds) == len(rows) == len({r.label for r in rows})
    assert set(ABLATIONS[name].columns) <= set(COLUMNS)
    assert ABLATIONS[name].picture in {"ssim", *COLUMNS}


def test_filters_are_scored_on_one_run(data, tmp_path):
    run_ablation("filter-phase", [data], tmp_path / "out", None, PAPER, Plan(alphas=(20.0,)), silent)
    assert len(list((tmp_path / "out").glob("runs/*/*/run"))) == 1
    lines = {line["row"]: line for line in lines_of(tmp_path / "out")}
    published, zero = (lines[f"linear, {kind}"] for kind in ("published", "zero-phase"))
    band = published["band_hz"]
    expected = TemporalFilter("published").response(tuple(band), [5.0], 30.0)[0]
    assert published["scalars"]["filter_phase_deg"] == pytest.approx(np.degrees(np.angle(expected)))
    assert published["scalars"]["filter_phase_deg"] == pytest.approx(30.0, abs=0.1)
    assert zero["scalars"]["filter_phase_deg"] == pytest.approx(0.0, abs=1e-9)
    with Image.open(tmp_path / "out" / "slices.png") as sheet:
        assert sheet.height > 7 * 96  # the truth and six rows
    assert "![Space-time slices](slices.png)" in (tmp_path / "out" / "results.md").read_text(encoding="utf-8")
    page = _ablation(tmp_path / "out", read_ablation(tmp_path / "out"))
    assert any(isinstance(block, Figure) and "Space-time" in block.caption for block in page.blocks)
    latex = (tmp_path / "out" / "tables" / "filter-phase.tex").read_text(encoding="utf-8")
    assert "linear, published" in latex
    pictures = [line["rows"]["20"][name]["ssim"] for name, line in lines.items()]
    assert len(set(pictures)) == len(pictures)


def test_views_are_left_out_and_rows_that_cannot_be_or_fail_are_named(data, tmp_path, monkeypatch):
    from tg4mm.research.bench.ablation import run as runner

    measured, out = runner.measure, tmp_path / "out"

    def measure(place, *arguments):
        if "5_views" in place.name:
            raise ArithmeticError("a matrix is singular")
        return measured(place, *arguments)

    monkeypatch.setattr(runner, "measure", measure)
    made = run_ablation("views", [data], out, None, MODAL, Plan(alphas=(20.0,)), silent)
    lines = {line["row"]: line for line in lines_of(out)}
    assert {name: line["n_views"] for name, line in lines.items()} == {"3 views": 3, "all views": 5}
    assert lines["3 views"]["log"]["motion"]["views"] == 3
    assert "10 views" not in ablation_table(made)
    page = (out / "results.md").read_text(encoding="utf-8")
    assert f"Left out: {data.name}, 10 views: dataset {data} has 5 training cameras, 10 are asked for" in page
    (failed,) = made["failed"]
    assert (failed["method"], failed["why"].partition(" (")[0]) == (
        "5 views",
        "ArithmeticError: a matrix is singular",
    )
    assert "in measure" in (out / "runs" / data.name / "traceback.txt").read_text(encoding="utf-8")


def test_a_broken_set_is_reported_and_the_rest_goes_on(data, tmp_path, capsys):
    (tmp_path / "broken").mkdir()
    torn, bare = (shutil.copytree(data, tmp_path / name) for name in ("torn", "bare"))
    picture = torn / "001" / "train" / "r_000.png"
    picture.write_bytes(picture.read_bytes()[:100])  # its size can still be read
    shutil.rmtree(bare / "magnified" / "x020")
    sets = [str(tmp_path / name) for name in ("broken", "torn", "bare")]
    settings = [part for k, v in MODAL.items() for part in ("--set", f"{k}={v}")]
    out = tmp_path / "out"
    options = ["--out", str(out), "--preset", "modal", "--alphas", "20", *settings]
    assert main(["bench", "ablation", "filter-phase", *sets, str(data), *options]) == 1
    assert "3 failed" in capsys.readouterr().err
    results = read_ablation(out)
    assert [f["set"] for f in results["failed"]] == ["broken", "bare", "torn"]
    assert {line["set"] for line in results["lines"]} == {data.name}
    page = (out / "results.md").read_text(encoding="utf-8")
    assert all(f"- Failed: {name}: " in page for name in ("broken", "torn", "bare"))
    assert (out / "slices.png").is_file()


def test_a_scene_is_filmed_in_every_way(data, tmp_path, monkeypatch):
    """An orbit is there as it is; the others are rendered, here by a copy that says what it was asked for."""
    source = shutil.copytree(data, tmp_path / data.name)
    scene = json.loads((source / "scene.json").read_text(encoding="utf-8"))
    made_by = {
        "scene": "mic",
        "n_test": 30,
        "n_points": 500,
        "engine": {"name": "CYCLES", "samples": 8},
        "cameras": {"kind": "orbit"},
        "sensor": None,
    }
    (source / "scene.json").write_text(json.dumps(scene | made_by))
    asked: list[list[str]] = []

    def generator(arguments):
        asked.append(arguments)
        made = dict(zip(arguments[1::2], arguments[2::2], strict=True))
        root = shutil.copytree(source, Path(made["--out"]) / "mic_3.4Hz")
        (root / "scene.json").write_text(json.dumps(scene | {"cameras": {"kind": made["--cameras"]}}))
        return 0

    monkeypatch.setattr("tg4mm.research.bench.ablation.sets.run_generator", generator)
    out = tmp_path / "out"
    results = run_ablation("capture", [source], out, None, MODAL, Plan(alphas=(20.0,)), silent)
    assert [line["row"] for line in results["lines"]] == list(KINDS)
    assert len(asked) == len(KINDS) - 1
    for arguments, kind in zip(asked, list(KINDS)[1:], strict=True):
        (settings,) = request_from(parser().parse_args(arguments)).sets
        assert (settings.cameras.kind, settings.alphas, settings.points) == (kind, (20,), 500)
        of_reference = 30 * open_set(source, "mic").n_timesteps  # test pictures
        assert abs(settings.cameras.n_test * settings.timesteps - of_reference) <= settings.timesteps / 2
    assert all(line["scalars"]["frequency_error_hz"] is not None for line in results["lines"])
    run_ablation("capture", [source], out, None, MODAL, Plan(alphas=(20.0,)), silent)
    assert len(asked) == len(KINDS) - 1  # what is there is not rendered again


def by_hand(values):
    """Results of two rows on two sets: {(set, row): ({α: SSIM}, displacement error)}."""
    rows = list(dict.fromkeys(row for _, row in values))
    lines = [
        {
            "set": name, "row": row, "ways": ["modal"], "ssim_columns": {f"α = {a}": a for a in ssims},
            "scalars": {"displacement_error": error},
            "rows": {a: {m: {"ssim": v} for m in (STATIC, "modal", CEILING)} for a, v in ssims.items()},
        }
        for (name, row), (ssims, error) in values.items()
    ]  # fmt: skip
    return {"lines": lines, "rows": rows, "columns": ["displacement_error"], "picture": "ssim"}


def test_means_over_sets_are_of_all_of_them():
    """What a set has for one row alone gives that row no mean that looks better for lack of the harder set."""
    results = by_hand({
        ("a", "one"): ({"5": 0.8, "20": 0.8}, 0.1), ("b", "one"): ({"5": 0.6}, None),
        ("a", "two"): ({"5": 0.9, "20": 0.7}, 0.2), ("b", "two"): ({"5": 0.5}, 0.4),
    })  # fmt: skip
    columns = ["α = 5", "α = 20"]
    one, two = mean_lines(results, columns)
    assert [line["rows"]["α = 5"]["modal"]["ssim"] for line in (one, two)] == pytest.approx([0.7, 0.7])
    assert one["rows"]["α = 20"]["modal"]["ssim"] is two["rows"]["α = 20"]["modal"]["ssim"] is None
    assert one["scalars"]["displacement_error"] is None
    assert two["scalars"]["displacement_error"] == pytest.approx(0.3)


def test_lpips_stands_beside_ssim_where_it_was_measured():
    results = by_hand({("a", "one"): ({"5": 0.8}, 0.1)})
    results |= {"sets": [{"label": "a"}], "title": "x", "name": "x", "remark": "", "source": "x"}
    assert not any("LPIPS" in title for title in ablation_cells(results).header)
    results["lines"][0]["rows"]["5"]["modal"]["lpips"] = 0.03
    table = ablation_cells(results)
    assert table.header[3:5] == ["SSIM α = 5", "LPIPS α = 5"]
    assert table.rows[1][3:5] == ["0.8000", "0.0300"]
