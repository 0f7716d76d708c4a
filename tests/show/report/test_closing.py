"""Costs and commands in words."""

import pytest

from tg4mm.core.pages.svg import size_text
from tg4mm.show.report.closing import _figure, program, size_on_disk
from tg4mm.show.report.summary import both_lengths, clock, length, total_seconds


@pytest.mark.parametrize(
    ("size", "text"), [(12, "12 B"), (12_345, "12.3 kB"), (4_560_000, "4.56 MB"), (2e9, "2 GB")]
)
def test_sizes_in_words(size, text):
    assert size_text(size) == text


def test_folders_count_all_their_files(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "x").write_bytes(b"123")
    (tmp_path / "y").write_bytes(b"12")
    assert size_on_disk(tmp_path) == 5
    assert size_on_disk(tmp_path / "y") == 2
    (tmp_path / "z").hardlink_to(tmp_path / "y")
    assert size_on_disk(tmp_path) == 5


def test_commands_name_the_program_as_the_shell_finds_it(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.executable", str(tmp_path / "python"))
    monkeypatch.setenv("PATH", str(tmp_path / "elsewhere"))
    assert program() == f"{tmp_path}/python -m tg4mm"
    (tmp_path / "tg4mm").touch(mode=0o755)
    assert program() == f"{tmp_path}/tg4mm"
    monkeypatch.setenv("PATH", str(tmp_path))
    assert program() == "tg4mm"


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("psnr_train", 41.42, "PSNR train 41.42 dB"),
        ("psnr_db", 31.5, "PSNR 31.5 dB"),
        ("n_gaussians", 4509, "gaussians 4,509"),
        ("explained_by_components", 0.9834, "these components hold 98.3 % of the changes in the images"),
    ],
)
def test_figures_of_a_stage_in_words(key, value, text):
    assert _figure(key, value) == text


def test_times_add_up_over_stages_that_have_one():
    assert (
        total_seconds({"space": {"seconds": 61.0}, "motion": {"seconds": 2}, "other": {}, "odd": 3}) == 63.0
    )
    assert total_seconds({}) is None
    assert [clock(s) for s in (2.04, 48, 200, 3900)] == ["2.0 s", "48 s", "3 min 20 s", "1 h 05 min"]


def test_metric_lengths_only_where_the_scale_is_known():
    assert length(0.005, None) == ("0.005", "units")
    assert length(0.005, 0.1) == ("0.5", "mm")
    assert length(0.0005, 0.1) == ("50", "µm")
    assert both_lengths(0.005, 1.0) == "0.005 scene units (5 mm)"
    assert both_lengths(0.005, None) == "0.005 scene units"
