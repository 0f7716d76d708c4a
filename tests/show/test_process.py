"""`tg4mm process` on a small video of one fixed camera: what it leaves, and what a second call does."""

import json
import re
from fractions import Fraction

import numpy as np
import pytest

from tests.capture.sfm.videos import write_video
from tg4mm.cli import main

pytestmark = pytest.mark.slow
HZ, FPS = 4.0, 20


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """2.5 s of 96×72 pixels, a part of which vibrates by .4 px."""
    pytest.importorskip("av", reason="needs the extra sfm")
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.arange(96.0), np.arange(72.0))
    waves = [(*rng.uniform(-0.8, 0.8, 2), rng.uniform(0, 2 * np.pi)) for _ in range(30)]
    part = np.exp(-((x - 48) ** 2 + (y - 36) ** 2) / 300)
    frames = []
    for k in range(50):
        shift = 0.4 * np.sin(2 * np.pi * HZ * k / FPS) * part
        grey = 128 + 12 * sum(np.cos(u * (x - shift) + v * y + p) for u, v, p in waves)
        noisy = grey[..., None] + rng.normal(0, 2, (72, 96, 3))
        frames.append(np.clip(noisy, 0, 255).astype(np.uint8))
    return write_video(tmp_path_factory.mktemp("video") / "shaft.mp4", frames, Fraction(FPS), crf=8)


def test_a_video_becomes_numbers_pages_and_a_magnified_video(video, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["process", str(video), "--out", str(out)]) == 0
    made = {p.name for p in out.iterdir()}
    files = {"magnified.mp4", "report.html", "page.html", "process.json"}
    assert made == {"dataset", "run", "measured", "magnified"} | files
    sensors = json.loads((out / "measured" / "measure.json").read_text(encoding="utf-8"))["sensors"]
    strongest = [s["peaks"][0]["frequency_hz"] for s in sensors if s["peaks"]]
    assert min(abs(hz - HZ) for hz in strongest) < 0.05
    assert sum(p.is_file() for p in out.rglob("*") if out / "dataset" not in p.parents) <= 40
    assert [p.name for p in (out / "magnified").iterdir()] == ["render.json"]
    levels = (out / "measured" / "analysis" / "levels.csv").read_text(encoding="utf-8")
    assert re.search(r"velocity,px/s,.*,rms,[0-9.]+,[0-9.]+\n", levels)
    said, progress = capsys.readouterr()
    first, *steps, hz, amplitude, where, missing, opens = said.splitlines()
    costs = "about 1 min of processor time and 0.6 GB"
    assert first.startswith(f"50 pictures of 96×72, one camera, if fixed: {costs}")
    assert len(steps) + len(progress.splitlines()) <= 40
    assert float(hz.removeprefix("frequency").split(" ± ")[0]) == pytest.approx(HZ, abs=0.05)
    assert amplitude.startswith("amplitude  0.")
    assert amplitude.endswith(" px")
    assert where.startswith("where      pixel ")
    assert missing.startswith("limits     a flat capture shows only motion across the line of sight")
    assert opens == f"open       {out / 'report.html'}"
    times = re.search(r"magnified.mp4: (\S+) times", said)[1]
    assert f"shown here {times} times larger" in (out / "report.html").read_text(encoding="utf-8")
    assert "magnified view" not in progress

    stamps = {p: p.stat().st_mtime_ns for p in out.rglob("*") if p.is_file() and p.name != "process.json"}
    assert main(["process", str(video), "--out", str(out)]) == 0
    assert capsys.readouterr().out.count("already done") == 7
    assert {p: p.stat().st_mtime_ns for p in stamps} == stamps

    assert main(["process", str(video), "--out", str(out), "--alpha", "3", "--band", "3", "5"]) == 0
    said = capsys.readouterr().out
    assert said.count("already done") == 5  # dataset, scale, run, measured, page
    assert "magnified.mp4: 4 times the motion from 3 to 5 Hz" in said
    assert not (out / "magnified_1").exists()
    options = ["--alpha", "3", "--band", "3", "5", "--all-files"]
    assert main(["process", str(video), "--out", str(out), *options]) == 0
    assert len(list((out / "magnified").glob("*/*.png"))) == 50
    assert list((out / "measured" / "plots").glob("*.svg"))


def test_a_still_film_is_answered(tmp_path, capsys):
    rng = np.random.default_rng(0)
    base = rng.integers(30, 220, (9, 12, 3)).repeat(8, 0).repeat(8, 1)
    frames = [np.clip(base + rng.normal(0, 1, base.shape), 0, 255).astype(np.uint8) for _ in range(40)]
    video = write_video(tmp_path / "still.mp4", frames, Fraction(FPS), crf=38)
    assert main(["process", str(video), "--out", str(tmp_path / "out")]) == 0
    assert "frequency  nothing vibrates" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--from -1", "--from is -1.0, expected"),
        ("--sensor a=box:1", "box"),
        ("--set space.iteration=5", "space.iterations"),
        ("--band 3 5 --band 7 9", "--band is given 2 times; expected once"),
        ("--alpha inf", "--alpha inf: must be a finite number"),
    ],
)
def test_bad_input_leaves_nothing(video, tmp_path, capsys, options, message):
    assert main(["process", str(video), "--out", str(tmp_path / "out"), *options.split()]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_what_the_dataset_tells_is_asked_before_training_and_another_rate_trains_again(
    video, tmp_path, capsys
):
    out = tmp_path / "out"
    for options, message in (
        (["--sensor", "a=pixel:cam_9,10,10"], "cam_9"),
        (["--band", "3", "12"], "reaches past half the frame rate"),
    ):
        assert main(["process", str(video), "--out", str(out), *options]) == 2
        assert message in capsys.readouterr().err
        assert not (out / "run").exists()
    assert main(["process", str(video), "--out", str(out), "--quick"]) == 0
    assert main(["process", str(video), "--out", str(out), "--quick", "--fps", "40"]) == 0
    assert (out / "run_1").is_dir()
    sensors = json.loads((out / "measured" / "measure.json").read_text(encoding="utf-8"))["sensors"]
    assert min(abs(s["peaks"][0]["frequency_hz"] - 2 * HZ) for s in sensors if s["peaks"]) < 0.1
    capsys.readouterr()
    assert main(["process", str(video), "--out", str(out), "--quick", "--fps", "40", "--band", "1", "2"]) == 2
    assert "no motion was found there" in capsys.readouterr().err
