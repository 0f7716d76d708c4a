"""`tg4mm report`: options arrive where they belong; bad ones give one line and no page."""

import pytest

from tg4mm.cli import main


def test_it_writes_the_page_into_the_run_and_says_how_large_it_is(run_path, capsys, monkeypatch):
    monkeypatch.setattr("tg4mm.show.report.write.metrics_of", lambda run, evaluate: {})
    options = ["--alpha", "3", "--band", "4", "6", "--sensor", "ball=sphere:0.5,0.1,0.37,0.4"]
    assert main(["report", str(run_path), *options]) == 0
    page = run_path / "report.html"
    assert capsys.readouterr().out == f"{page}: {page.stat().st_size / 1e6:.1f} MB\n"
    text = page.read_text(encoding="utf-8")
    assert "Ours, α = 3" in text
    assert "4 to 6 Hz" in text
    assert "Sensor “ball”" in text
    assert f"report {run_path} --alpha 3 --band 4 6 --sensor ball=sphere:0.5,0.1,0.37,0.4" in text


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--band", "6.4", "7"], "no motion was found there"),
        (["--band", "1", "2", "--band", "4", "6"], "--band is given 2 times"),
        (["--band", "4", "40"], "half the frame rate"),
        (["--alpha", "nan"], "--alpha nan"),
        (["--sensor", "a=cube:1"], "'cube'"),
        (["--sensor", "far=sphere:99,0,0,.1"], "far"),
        (["--sensor", "a=all", "--sensor", "a=all"], "two sensors are called"),
        (["--alpha", "x"], "x"),
    ],
)
def test_bad_options_give_one_line_and_no_page(run_path, tmp_path, capsys, options, message):
    out = tmp_path / "page.html"
    assert main(["report", str(run_path), "--out", str(out), *options]) == 2
    error = capsys.readouterr().err.strip()
    assert message in error.splitlines()[-1]
    assert not out.exists()
