"""`tg4mm look`: what a video shows, in words, a picture, a page and JSON; what is no recording is said in one line."""

import json
import re

import numpy as np
import pytest
from PIL import Image

from benchmarks.calibration.film import Coding, Film, FilmMode, Layer, texture, write_video
from tg4mm.capture.look.record import from_record
from tg4mm.cli import main

WIDTH, HEIGHT, FPS, FRAMES, HZ = 128, 96, 30, 120, 5.2
PLATE = (32, 32, 96, 80)


def film(size_px):
    """A plate that moves to the right and down before a wall that is still."""
    rng = np.random.default_rng(3)
    shape = np.broadcast_to([0.8 * size_px, 0.6 * size_px], (HEIGHT, WIDTH, 2))
    mode = FilmMode(shape, lambda t: float(np.cos(2 * np.pi * HZ * t)))
    wall, plate = (texture(HEIGHT, WIDTH, rng, 0.3, 0.3, (1.5, 4.0)) for _ in range(2))
    return Film([Layer(wall, None, [], 0.6), Layer(plate, PLATE, [mode], 0.6)], FPS, FRAMES, 3.0, seed=3)


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    path = tmp_path_factory.mktemp("look") / "my pump.mp4"
    write_video(path, film(0.2).pictures(), FPS, Coding("libx264", 1_500_000))
    return path


def test_a_video_is_described_in_words_and_drawn(video, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["look", str(video)]) == 0
    said = capsys.readouterr().out
    assert "120 pictures of 128×96 at 30 Hz, 4 s" in said
    first = next(line for line in said.splitlines() if "right" in line)
    assert float(first.split()[0]) == pytest.approx(HZ, abs=0.02)
    right, up = (float(number.replace("−", "-")) for number in re.findall(r"(\S+) (?:right|up)", first))
    assert (right, up) == pytest.approx((0.8, -0.6), abs=0.1)
    assert "|k × 30 Hz ± f|" in said
    assert f"tg4mm process '{video}' --kind flat --out 'my pump'-out" in said
    assert Image.open(tmp_path / "my pump-look.png").size[0] > 1000
    assert [path.name for path in tmp_path.iterdir()] == ["my pump-look.png"]


def test_a_page_and_json_go_to_a_folder(video, tmp_path):
    out = tmp_path / "a" / "b"
    assert main(["look", str(video), "--out", str(out), "--fps", "240"]) == 0
    assert {path.name for path in out.iterdir()} == {"look.html", "look.json", "look.png"}
    values = json.loads((out / "look.json").read_text())
    (line,) = from_record(values).vibrations
    assert line.hz == pytest.approx(8 * HZ, abs=0.2)
    assert abs(line.amplitude_px - 0.2) < 3 * line.amplitude_deviation_px
    assert line.kept is not None
    assert values["fps"] == pytest.approx(240)
    assert 0 < values["smallest"][0]["best_px"] <= values["smallest"][0]["amplitude_px"] < 0.2
    page = (out / "look.html").read_text()
    assert "one vibration" in page.lower()
    assert "--fps 240" in page


def test_a_part_of_the_video(video, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["look", str(video), "--from", "1", "--until", "3"]) == 0
    said = capsys.readouterr().out
    assert ": 60 pictures" in said
    assert "--kind flat --from 1 --until 3 --out" in said
    assert main(["look", str(video), "--until", "0.5"]) == 2
    assert "holds 15 pictures; at least 24 are needed" in capsys.readouterr().err


def test_a_readout_is_taken_into_account_and_handed_on(video, tmp_path, capsys):
    assert main(["look", str(video), "--out", str(tmp_path), "--readout", "12.5"]) == 0
    assert "--kind flat --readout 12.5 --out" in capsys.readouterr().out
    assert from_record(json.loads((tmp_path / "look.json").read_text())).rows_s == 0.0125
    assert main(["look", str(video), "--readout", "40"]) == 2
    assert "--readout is 40, expected at most the 33.33 ms of a frame of my pump" in capsys.readouterr().err


def test_a_folder_of_numbered_pictures_needs_its_rate(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "frames"
    folder.mkdir()
    for k, grey in enumerate(film(0.2).pictures()):
        Image.fromarray(np.asarray(grey)).convert("L").save(folder / f"{k}.png")
    assert main(["look", str(folder)]) == 2
    assert (
        "frames: a folder of pictures has no frame times; give the frame rate with --fps HZ"
        in capsys.readouterr().err
    )
    assert main(["look", str(folder), "--fps", str(FPS)]) == 0
    said = capsys.readouterr().out
    assert "rings down" not in said
    first = next(line for line in said.splitlines() if "right" in line)
    assert float(first.split()[0]) == pytest.approx(HZ, abs=0.02)


def test_where_nothing_vibrates_it_is_said_with_how_small_a_motion_would_be_found(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    write_video(tmp_path / "still.mp4", film(0.0).pictures(), FPS, Coding("libx264", 1_500_000))
    assert main(["look", "still.mp4"]) == 0
    said = capsys.readouterr().out
    assert "no vibration stands out of the noise" in said
    assert "a steady vibration is found from about 0.0" in said
    assert "film longer" not in said.splitlines()[0]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("gone.mp4", "gone.mp4: does not exist"),
        ("notes.txt", "notes.txt: is neither a folder of pictures nor a video"),
        ("noise.mp4", "noise.mp4: is not a video that can be decoded"),
        ("empty", "empty: holds no pictures"),
        ("noise.mp4 --fps 0", "--fps is 0; expected a frame rate above 0 Hz"),
        ("noise.mp4 --readout -1", "--readout is -1.0, expected"),
        ("noise.mp4 --readout nan", "--readout is nan, expected"),
        ("noise.mp4 --from 3 --until 2", "--from 3 --until 2: selects nothing"),
        ("empty --from 3", "--from and --until apply to videos"),
        ("noise.mp4 --png a.jpg", "--png a.jpg: expected a name that ends in .png"),
        ("noise.mp4 --out notes.txt", "--out notes.txt: is a file; expected a folder"),
    ],
)
def test_what_is_no_recording_is_one_line(arguments, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "notes.txt").write_text("hello")
    (tmp_path / "noise.mp4").write_bytes(bytes(500))
    (tmp_path / "empty").mkdir()
    before = sorted(tmp_path.iterdir())
    assert main(["look", *arguments.split()]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == before


def regions(path, **more):
    """A file of regions: the plate, its upper edge, the wall; a scale of 2 mm a pixel."""
    drawn = [{"name": "plate", "box": PLATE}, {"name": "wall", "box": [0, 0, 28, 96]}]
    scale = [{"points": [[32, 32], [96, 32]], "metres": 0.128}]
    values = {"format": "tg4mm", "kind": "regions", "version": 1, "size": [WIDTH, HEIGHT], "regions": drawn}
    path.write_text(json.dumps(values | {"lengths": scale} | more))
    return str(path)


def test_drawn_regions_have_lines_of_their_own_in_millimetres(video, tmp_path, capsys):
    out, file = tmp_path / "out", regions(tmp_path / "r.json")
    assert main(["look", str(video), "--regions", file, "--out", str(out)]) == 0
    plate, wall = json.loads((out / "look.json").read_text())["regions"]
    assert wall["lines"] == []
    (line,) = plate["lines"]
    assert line["hz"] == pytest.approx(HZ, abs=0.02)
    assert abs(line["amplitude_px"] - 0.2) < 3 * line["amplitude_deviation_px"] < 0.06
    said = next(row for row in capsys.readouterr().out.splitlines() if row.strip().startswith("plate"))
    mm, sure, speed = re.search(r"up +>? ?([\d.]+) ± ([\d.]+) +>? ?([\d.]+)", said).groups()
    assert abs(float(mm) - 0.4) < 3 * float(sure)
    assert float(speed) == pytest.approx(float(mm) * 2 * np.pi * HZ / 2**0.5, rel=0.02)
    assert f"--regions {file}" in (out / "look.html").read_text()


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"size": [64, 64]}, "regions are of pictures of 64×64 pixels, those of .* 128×96 pixels: draw them"),
        ({"regions": [{"name": "dot", "point": [50, 50, 3]}]}, "region 'dot' covers no cell of 16×16 pixels"),
        ({"regions": [{"name": "far", "box": [200, 0, 210, 9]}]}, "lies outside the picture"),
        (
            {"lengths": [{"points": [[0, 0], [0, 64]], "metres": m} for m in (0.1, 0.2)]},
            "two lengths disagree",
        ),
    ],
)
def test_regions_that_cannot_be_are_one_line(video, tmp_path, capsys, more, said):
    out = tmp_path / "out"
    drawn = regions(tmp_path / "r.json", **more)
    assert main(["look", str(video), "--regions", drawn, "--out", str(out)]) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert re.search(said, error)
    assert not out.exists()
