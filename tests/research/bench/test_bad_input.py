"""What the command refuses: exit code 2, one line, nothing written."""

import pytest

from tg4mm.cli import main


def refused(arguments, capsys):
    assert main(["bench", *arguments]) == 2
    message = capsys.readouterr().err
    assert len(message.strip().splitlines()) == 1, message
    return message


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--methods", "modal,nerf"], "'nerf'"),
        (["--methods", "modal,modal"], "modal twice"),
        (["--methods", ""], "--methods"),
        (["--set", "tracking.colour=1"], "tracking.colour"),
        (["--methods", "linear-2d", "--set", "tracking.iterations=5"], "tracking.iterations: no method here"),
        (["--methods", "linear-2d", "--set", "space.iterations=5"], "space.iterations: no method here"),
        (["--md-vqa", "/nowhere"], "holds no test_video.py"),
        (["--alphas", "5,many"], "'many'"),
        (["--alphas", "-3"], "-3"),
        (["--alphas", "7"], "ground truth for 5, 20"),
        (["--same-time", "sometimes"], "sometimes"),
        (["--set", "space.colour=1"], "space.colour"),
        (["--set", "space.iterations=-4"], "-4"),
        (["--set", "paper.resolution=100"], "100"),
        (["--set", "motion.iterations=x"], "'x'"),
        (["--lpips-weights", "/nowhere/alex.pth"], "/nowhere/alex.pth"),
        (["--external", "theirs"], "expected NAME=DIR"),
        (["--external", "a/b=."], "letters, digits"),
        (["--external", "theirs=/nowhere"], "/nowhere is not a folder"),
        (["--external", "modal=."], "that is the name of a row here"),
        (["--external", "ceiling=."], "that is the name of a row here"),
        (["--external", "Linear-2D=."], "that is the name of a row here"),
        (["--external", "set.json=."], "that is the name of a row here"),
        (["--external", "-x=."], "must not begin with . or -"),
    ],
)
def test_options_of_scenes(options, message, data, tmp_path, capsys):
    out = tmp_path / "out"
    assert message in refused(["scenes", str(data), "--out", str(out), *options], capsys)
    assert not out.exists()


def test_datasets_that_are_none(tmp_path, capsys):
    out = tmp_path / "out"
    assert "nowhere" in refused(["scenes", "/nowhere", "--out", str(out)], capsys)
    (tmp_path / "empty").mkdir()
    assert "empty" in refused(["scenes", str(tmp_path / "empty"), "--out", str(out)], capsys)
    assert not out.exists()


def test_folders_of_something_else_are_left_alone(data, tmp_path, capsys):
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "letter.txt").write_text("mine")
    assert "holds no bench.json" in refused(["scenes", str(data), "--out", str(foreign)], capsys)
    assert [p.name for p in foreign.iterdir()] == ["letter.txt"]
    other = tmp_path / "other"
    other.mkdir()
    (other / "bench.json").write_text('{"format": "tg4mm-bench", "version": 1, "kind": "something else"}')
    assert "something else" in refused(["scenes", str(data), "--out", str(other)], capsys)
    (other / "bench.json").write_text("{")
    assert "bench.json" in refused(["scenes", str(data), "--out", str(other)], capsys)
    assert [p.name for p in other.iterdir()] == ["bench.json"]
    (tmp_path / "file").write_text("")
    assert "is a file" in refused(["scenes", str(data), "--out", str(tmp_path / "file")], capsys)
