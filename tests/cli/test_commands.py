"""What the commands do with good input: options arrive where they belong, results lie where they should."""

import json
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from contextlib import contextmanager

import numpy as np
import pytest
import torch
from PIL import Image

from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.cli import main
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.splatfile import positions_at, read_splat
from tg4mm.fit.device import check_device, full_precision
from tg4mm.run import Run

N_TIMESTEPS, SIZE = 6, 32


def tree(folder, pattern):
    return {str(path.relative_to(folder)) for path in folder.rglob(pattern)}


def recorded(folder):
    return json.loads((folder / "render.json").read_text())


def test_export_of_a_sequence_takes_alpha_and_band(run_path, tmp_path):
    main(["export", str(run_path), "--out", str(tmp_path / "a.ply")])
    splat = read_splat(tmp_path / "a.ply")
    for name, band in (("inside", (4.0, 6.0)), ("outside", (1.0, 2.0))):
        common = ["--format", "ply-sequence", "--alpha", "10", "--allow-empty-band"]
        options = [*common, "--band", *map(str, band)]
        assert main(["export", str(run_path), "--out", str(tmp_path / name), *options]) == 0
        frame = read_splat(tmp_path / name / "frame_0002.ply")
        np.testing.assert_allclose(frame.means, positions_at(splat, 2, 10.0, band), atol=1e-5)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("x.spz", "expected a name that ends in .ply, such as {}/x.ply"),
        ("x", "such as {}/x.ply, or {}/x/splat.ply"),
        ("x/", "such as {}/x.ply, or {}/x/splat.ply"),
    ],
)
def test_a_splat_file_is_named_as_one(run_path, tmp_path, capsys, name, said):
    assert main(["export", str(run_path), "--out", f"{tmp_path}/{name}"]) == 2
    assert said.replace("{}", str(tmp_path)) in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    assert main(["export", str(run_path), "--out", f"{tmp_path}/x.PLY"]) == 0


def test_render_takes_split_band_and_no_video(run_path, tmp_path):
    out = tmp_path / "train"
    options = ["--split", "train", "--band", "4", "6", "--no-video", "--alpha", "-1"]
    assert main(["render", str(run_path), "--out", str(out), *options]) == 0
    assert len(tree(out, "*.png")) == 3 * N_TIMESTEPS
    assert tree(out, "*.mp4") == set()
    assert (recorded(out)["alpha"], recorded(out)["band_hz"]) == (-1.0, [4.0, 6.0])


def test_render_takes_an_orbit_in_slow_motion(run_path, tmp_path):
    out = tmp_path / "orbit"
    options = ["--alpha", "3", "--orbit", "4", "--slow", "2"]
    assert main(["render", str(run_path), "--out", str(out), *options]) == 0
    assert tree(out, "*.png") == {f"r_{i:03d}.png" for i in range(4)}
    assert tree(out, "*.mp4") == {"orbit.mp4"}
    assert recorded(out)["slow"] == 2.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("inf", "--alpha inf"),
        ("1 --alpha 2", "--alpha is given 2 times, --band 0 times: without --band give exactly one --alpha"),
        ("1 --band 1 2 --band 3 4", "give one --alpha for each --band"),
        ("1 --band 4", "--band '4' is neither two frequencies in Hz"),
        ("1 --band 4 --no-video", "--band '4' is neither two frequencies in Hz, LO HI, nor auto"),
        ("1 --band --no-video", "--band '' is neither two frequencies in Hz"),
        ("1 --band=4 --no-video", "--band '4' is neither two frequencies in Hz"),
        ("1 --band -4 6", "band (-4, 6) Hz starts below 0 Hz"),
        (
            "1 --band 7.2 7.4",
            "no motion was found there; no vibration stands out, and the modes lie at 5 Hz; --allow",
        ),
        ("1 --alpha 2 --band 1 4 --band 3 5", "overlap: 3 Hz lies in both"),
        ("1 --method phase", "--method phase"),
        ("1 --filter ideal", "--filter ideal needs --band: without a band nothing is"),
        ("1 --band 4 6 --filter ideal", "--filter ideal: the method modal picks modes"),
        ("1 --amplitude-percentile 50", "--amplitude-percentile is an option of the method phase"),
        ("1 --slow 2 --no-video", "--slow 2 and --no-video cannot be used together"),
        ("1 --band 4 40", "(4, 40) Hz reaches past half the frame rate"),
        ("1 --slow 0", "--slow 0"),
        ("1 --slow 1e9", "pictures a second: expected 0.01 … 10000; see --slow"),
        ("nan", "--alpha nan"),
        ("1e308", "must be within ±1e+06"),
        ("1 --cameras nowhere.json", "nowhere.json: cannot be read"),
    ],
)
def test_render_refuses_bad_values(run_path, tmp_path, capsys, options, message):
    assert main(["render", str(run_path), "--out", str(tmp_path / "o"), "--alpha", *options.split()]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize(
    "words",
    [
        "train DATA --out FILE/x",
        "render RUN --alpha 1 --out FILE/x",
        "render RUN --alpha 1 --out FILE",
        "evaluate RUN --out FILE/x/m.json",
        "export RUN --out FILE/x/a.ply",
        "export RUN --out FILE/x --format ply-sequence",
    ],
)
def test_out_that_cannot_be_made_is_one_line(run_path, tmp_path, capsys, words):
    (tmp_path / "file").write_text("mine")
    places = {"RUN": str(run_path), "DATA": str(run_path.parent / "data"), "FILE": str(tmp_path / "file")}
    assert (
        main([re.sub("^(RUN|DATA|FILE)", lambda found: places[found[0]], word) for word in words.split()])
        == 2
    )
    line = capsys.readouterr().err
    file = re.escape(places["FILE"])
    reasons = rf"{file}[/x]*(: | cannot be written: )(Not a directory|File exists)|{file} is a file, expected a folder"
    assert re.fullmatch(rf"tg4mm: ({reasons})\n", line), line
    assert (tmp_path / "file").read_text() == "mine"


def test_without_test_cameras_render_names_the_others(tmp_path, capsys):
    gaussians, _ = make_synthetic_dataset(tmp_path / "data", n_views=2, n_timesteps=1, size=SIZE, n_test=0)
    run = Run.create(tmp_path / "run", tmp_path / "data", "modal", {})
    run.save_space(gaussians, {})
    command = ["render", str(run.path), "--alpha", "0", "--out", str(tmp_path / "o")]
    assert main(command) == 2
    assert "no 'test' split; choose --split train, --orbit N or --cameras FILE" in capsys.readouterr().err
    assert main([*command, "--split", "test"]) == 2
    assert "choose" not in capsys.readouterr().err
    assert main([*command, "--split", "train"]) == 0
    (tmp_path / "data").rename(tmp_path / "gone")
    assert main(command) == 2
    assert "choose" not in capsys.readouterr().err


def test_evaluate_prints_a_table_and_writes_the_figures(run_path, tmp_path, capsys):
    out = tmp_path / "metrics.json"
    assert main(["evaluate", str(run_path), "--alphas", "5", "--out", str(out)]) == 0
    metrics = json.loads(out.read_text())
    assert [entry["alpha"] for entry in metrics["alphas"]] == [0, 5]
    printed = capsys.readouterr().out
    assert "| 5 |" in " ".join(printed.split())
    assert "nothing moves" in printed


def test_evaluate_refuses_an_alpha_without_ground_truth_and_a_band_without_motion(run_path, tmp_path, capsys):
    out = tmp_path / "metrics.json"
    evaluate = ["evaluate", str(run_path), "--out", str(out), "--alphas"]
    command = [*evaluate, "5", "--band", "6.4", "7"]
    for words, message in (
        ([*evaluate, "5,3"], "--alphas holds α = 3: no such ground truth under"),
        (command, "--band 6.4 7: no motion was found there"),
    ):
        assert main(words) == 2
        assert message in capsys.readouterr().err
        assert not out.exists()
    assert main([*command, "--allow-empty-band"]) == 0


def test_a_killed_generator_is_said_and_leaves_with_1(monkeypatch, capsys):
    class Killed:
        def __init__(self, command, **options): ...
        def __enter__(self):
            return self

        def __exit__(self, *_): ...
        def wait(self):
            return -9

    monkeypatch.setattr("tg4mm.research.generator.subprocess.Popen", Killed)
    assert main(["generate", "mic", "--out", "x"]) == 1
    assert "ended by signal 9; run the same command again" in capsys.readouterr().err


def test_report_writes_the_page_into_the_run_and_says_how_large_it_is(run_path, capsys, monkeypatch):
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
        ("--band 6.4 7", "no motion was found there"),
        ("--band 1 2 --band 4 6", "--band is given 2 times"),
        ("--band 4 40", "half the frame rate"),
        ("--alpha nan", "--alpha nan"),
        ("--sensor a=cube:1", "'cube'"),
        ("--sensor far=sphere:99,0,0,.1", "far"),
        ("--sensor a=all --sensor a=all", "two sensors are called"),
        ("--alpha x", "x"),
    ],
)
def test_bad_options_of_report_give_one_line_and_no_page(run_path, tmp_path, capsys, options, message):
    out = tmp_path / "page.html"
    assert main(["report", str(run_path), "--out", str(out), *options.split()]) == 2
    error = capsys.readouterr().err.strip()
    assert message in error.splitlines()[-1]
    assert not out.exists()


@contextmanager
def started(*arguments, root):
    command = [sys.executable, "-m", "tg4mm", "view", *arguments, "--no-open", "--port", "0"]
    process = subprocess.Popen(command, cwd=root, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def test_view_serves_the_page_and_ends_cleanly_at_ctrl_c(run_path, repo_root):
    with started(str(run_path), root=repo_root) as process:
        line = process.stdout.readline()
        assert line.startswith("http://127.0.0.1:")
        assert line.endswith("(Ctrl+C ends)\n")
        with urllib.request.urlopen(line.split()[0], timeout=30) as answer:
            assert answer.status == 200
        process.send_signal(signal.SIGINT)
        begun = time.monotonic()
        out, err = process.communicate(timeout=60)
        assert time.monotonic() - begun < 20
        assert process.returncode == 0
        assert out == ""
        assert "Traceback" not in err


def test_a_port_in_use_is_one_line(run_path, capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert main(["view", str(run_path), "--no-open", "--port", port]) == 2
    err = capsys.readouterr().err
    assert err == f"tg4mm: port {port} on 127.0.0.1 is in use, or not allowed: choose another with --port\n"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--alpha nan", "--alpha nan: expected a finite number"),
        ("--band 3 5 --band 6 7", "--band is given 2 times"),
        ("--band 5 90", "reaches past half the frame rate, 7.5 Hz"),
        ("--port 70000", "--port 70000: expected 0 … 65535"),
    ],
)
def test_bad_options_of_view_are_one_line(run_path, options, message, capsys):
    assert main(["view", str(run_path), "--no-open", *options.split()]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1


def cameras_of(run_path):
    return Run.open(run_path).dataset / "000" / "transforms_test.json"


def rendered(what, out, cameras, *options):
    """[T, H, W, 3] of the first camera."""
    common = ["--cameras", str(cameras), "--out", str(out), "--no-video", *options]
    assert main(["render", str(what), *common]) == 0
    return np.array([np.asarray(Image.open(p)) / 255 for p in sorted(out.glob("*/r_000.png"))])


def psnr(a, b):
    return float(-10 * np.log10(max(((a - b) ** 2).mean(), 1e-12)))


@pytest.mark.parametrize("low_pass", ["none", "baked"])
def test_a_splat_file_is_rendered_as_its_run(run_path, tmp_path, low_pass):
    cameras, file = cameras_of(run_path), tmp_path / "a.ply"
    assert main(["export", str(run_path), "--out", str(file), "--low-pass", low_pass]) == 0
    options = ("--alpha", "20", "--band", "4", "6", "--allow-empty-band")
    of_run, of_file = (rendered(what, tmp_path / what.stem, cameras, *options) for what in (run_path, file))
    # With the low-pass in its scales a Gaussian is as wide as at the mean distance of the cameras.
    assert psnr(of_run, of_file) > (55 if low_pass == "none" else 35)
    still = rendered(file, tmp_path / "still", cameras, "--alpha", "0")
    assert psnr(of_run, still) < psnr(of_run, of_file) - 6


@pytest.mark.parametrize("options", [[], ["--split", "test"], ["--orbit", "4"]])
def test_a_splat_file_has_no_cameras(run_path, tmp_path, capsys, options):
    file = tmp_path / "a.ply"
    main(["export", str(run_path), "--out", str(file)])
    assert main(["render", str(file), "--alpha", "0", "--out", str(tmp_path / "out"), *options]) == 2
    said = capsys.readouterr().err.splitlines()
    assert "a.ply is a splat file, which has no cameras: give --cameras FILE" in said[-1]
    assert not (tmp_path / "out").exists()


def test_what_is_no_splat_file_is_one_line(run_path, tmp_path, capsys):
    (tmp_path / "a.ply").write_bytes(b"ply\n")
    out = tmp_path / "out"
    assert main(["render", str(tmp_path / "a.ply"), "--alpha", "0", "--out", str(out)]) == 2
    assert "a.ply: header has no end_header" in capsys.readouterr().err
    assert not out.exists()


def test_pictures_of_another_file_are_not_mixed_in(run_path, tmp_path, capsys):
    cameras, out = cameras_of(run_path), tmp_path / "out"
    for name, low_pass in (("a", "none"), ("b", "baked")):
        main(["export", str(run_path), "--out", str(tmp_path / f"{name}.ply"), "--low-pass", low_pass])
    rendered(tmp_path / "a.ply", out, cameras, "--alpha", "0")
    again = ["render", str(tmp_path / "b.ply"), "--alpha", "0", "--cameras", str(cameras), "--out", str(out)]
    assert main(again) == 2
    assert "out was made of another model: give another folder" in capsys.readouterr().err


def test_an_unknown_device_is_named():
    with pytest.raises(Tg4mmError, match=r"\Adevice is 'tpu', expected cpu or cuda\Z"):
        check_device("tpu")


@pytest.mark.parametrize(
    ("has_gpu", "said"),
    [
        (False, "device is cuda, but torch finds no CUDA device here"),
        (True, 'device cuda needs gsplat: pip install "tg4mm[cuda]"'),
    ],
)
@pytest.mark.parametrize("words", ["train DATA", "render RUN --alpha 5", "evaluate RUN"])
def test_cuda_without_a_gpu_or_gsplat_is_one_line_and_2(
    words, has_gpu, said, run_path, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: has_gpu)
    monkeypatch.setitem(sys.modules, "gsplat", None)
    out = tmp_path / "out"
    words = words.replace("DATA", str(run_path.parent / "data")).replace("RUN", str(run_path)).split()
    assert main([*words, "--out", str(out), "--device", "cuda"]) == 2
    assert capsys.readouterr().err == f"tg4mm: {said}\n"
    assert not out.exists()


def test_full_precision_ends_with_its_block(monkeypatch):
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", True)
    with full_precision("cuda"):
        assert not torch.backends.cudnn.allow_tf32
    assert torch.backends.cudnn.allow_tf32
    with pytest.raises(KeyError), full_precision("cuda"):
        raise KeyError
    assert torch.backends.cudnn.allow_tf32
    with full_precision("cpu"):
        assert torch.backends.cudnn.allow_tf32
