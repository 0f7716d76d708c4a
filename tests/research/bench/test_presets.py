"""The whole benchmark as commands: one after the other, by Snakemake, and what a failure leaves out."""

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import tg4mm.research.bench
from dataset_gen.options import parser, request_from
from tests.helpers.snakemake_program import snakemake
from tg4mm.cli import main
from tg4mm.cli.program import app
from tg4mm.research.bench import BenchError, presets
from tg4mm.research.bench.presets import (
    PRESETS,
    Choices,
    PresetStep,
    choices_from,
    preset_from,
    run_preset,
    steps_of,
)

ROOT = Path(__file__).parents[3]
SNAKEFILE = Path(tg4mm.research.bench.__file__).parent / "Snakefile"

# Plans as the real one does; other commands are recorded. Of phase-2d's the first is killed where `kill` is there, and
# all fail where `fail` is.
STAND_IN = """#!{python}
import os, runpy, signal, sys
sys.path.insert(0, {root!r})
if sys.argv[2] == "tg4mm.research.bench.presets":
    sys.argv = sys.argv[2:]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
    sys.exit()
line = " ".join(sys.argv[3:])
with open({log!r}, "a") as log:
    log.write(line + "\\n")
if os.path.exists({kill!r}) and " phase-2d --out" in line:
    os.unlink({kill!r})
    os.kill(os.getpid(), signal.SIGKILL)
sys.exit("does not work" if os.path.exists({fail!r}) and " phase-2d --out" in line else 0)
"""


def accepted(line):
    """The values that the program reads from a command, by the parsers of its own command line."""
    python, *module, name = (words := shlex.split(line))[:4]
    assert [python, *module] == [sys.executable, "-m", "tg4mm"]
    if name == "generate":
        request = request_from(parser().parse_args(words[4:]))
        return {"alphas": ",".join(map(str, request.sets[0].alphas)), "out": request.out}
    _, bound, _ = app.parse_args(words[3:], exit_on_error=False, print_error=False)
    return bound.arguments


@pytest.mark.parametrize("name", PRESETS)
def test_a_dry_run_prints_commands_that_the_program_accepts(name, capsys):
    assert main(["bench", "--preset", name, "--out", "out", "--dry-run"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(steps_of(name, "out"))
    assert not Path("out").exists()
    some = (*lines[:: 1 + len(lines) // 40], lines[-1])  # of hundreds that are alike
    folders = [str(accepted(line)["out"]) for line in some]
    assert {folder.partition("/")[0] for folder in folders} == {"out"}


def test_what_is_chosen_reaches_every_step_that_it_is_for(tmp_path):
    choices = Choices(("theirs=dir",), "5,20", "cuda", ("alex.pth", "heads.pth"), "md", "fast", "python3.9")
    for step in steps_of("small", "out", choices=choices):
        found = accepted(shlex.join(step.command))
        kind = step.name.partition("/")[0]
        assert found["alphas"] == "5,20"
        if kind != "data":
            assert found["device"] == "cuda"
            assert found["lpips_weights"] == (Path("alex.pth"), Path("heads.pth"))
        if kind in {"job", "page"}:
            assert found["external"] == ("theirs=dir",)
            assert (found["md_vqa"], found["fast_vqa"]) == (Path("md"), Path("fast"))
            assert found["vqa_python"] == "python3.9"


def test_a_configuration_file_has_the_same_choices():
    config = {"preset": "small", "alphas": 20, "lpips_weights": ["a", "b"], "external": ["t=d"], "threads": 2}
    assert choices_from(config) == Choices(("t=d",), "20", lpips_weights=("a", "b"))
    with pytest.raises(BenchError, match="external is 't=d', expected a list of texts"):
        choices_from({"external": "t=d"})
    with pytest.raises(BenchError, match=r"alphas is \[5\], expected a text"):
        choices_from({"alphas": [5]})


def test_the_test_split_shares_no_motion_training_camera_or_seed_with_the_dev_split():
    def sets(name):
        steps = [step for step in steps_of(name, "out") if step.name.startswith("data/")]
        return [request_from(parser().parse_args([*step.command[4:]])).sets[0] for step in steps]

    dev, test = sets("dev"), sets("test")
    assert (len(dev), len(test)) == (10, 8)
    motions = [{str(s.motion.to_json()["modes"]) for s in split} for split in (dev, test)]
    assert motions[0].isdisjoint(motions[1])
    assert {s.seed for s in dev}.isdisjoint({s.seed for s in test})
    assert ({s.cameras.kind for s in dev}, {s.cameras.kind for s in test}) == ({"orbit"}, {"rig"})
    assert {s.noise for s in (*dev, *test)} == {"picture"}
    assert {s.motion.main.frequency_hz for s in dev} == {
        3,
        4.3,
        5,
    }  # twelve pictures at 30 Hz: bins of 2.5 Hz
    assert all(len({s.seed for s in split}) == 3 for split in (dev, test))
    assert all(len({m["frequency"] for m in s.motion.to_json()["modes"]}) == 2 for s in test)


def test_a_configuration_file_can_name_scenes_seeds_and_methods():
    config = {
        "preset": "small", "scenes": ["mic", "mic --frequency 4.3"], "seeds": [0, 1], "methods": ["modal"],
        "options": "--size 32",
    }  # fmt: skip
    steps = {step.name: step for step in steps_of(preset_from(config), "out")}
    assert list(steps)[:2] == ["data/seed0/mic_5Hz_0_005", "data/seed0/mic_4_3Hz_0_005"]
    assert "job/mic_4_3Hz_0_005_s1/modal" in steps
    assert steps["job/mic_5Hz_0_005_s1/modal"].needs == ("data/seed1/mic_5Hz_0_005",)
    assert "mic_5Hz_0_005_s1=out/data/seed1/mic_5Hz_0_005" in steps["page"].command


@pytest.mark.parametrize(
    ("own", "message"),
    [
        ({"seeds": ["a"]}, r"seeds is \['a'\], expected a list of whole numbers"),
        ({"scenes": "mic"}, "scenes is 'mic', expected a list of texts"),
        ({"options": ["--size"]}, "options is .*, expected a text"),
        ({"scenes": []}, "scenes is .*, expected one or more"),
        ({"methods": ["modal", "best"]}, "holds 'best', expected some of modal, "),
        (
            {"scenes": ["mic", "mic --samples 3"]},
            "'mic --samples 3' and another scene have the same folder mic_5Hz",
        ),
    ],
)
def test_a_configuration_that_will_not_do(own, message):
    with pytest.raises(BenchError, match=message):
        steps_of(preset_from({"preset": "small", **own}), "out")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--preset", "large", "--out", "x"], "'large', expected smoke, small, dev, test, paper"),
        (["--preset", "smoke"], "--out are needed"),
        (["--preset", "smoke", "--out", "x", "--alphas", "5,many"], "'many'"),
        (["--preset", "smoke", "--out", "x", "--fast-vqa", "/nowhere"], "holds no vqa.py"),
        (["--preset", "smoke", "--out", "x", "--lpips-weights", "/nowhere/alex.pth"], "/nowhere/alex.pth"),
        (["--alphas", "5", "scenes", "data", "--out", "x"], "unexpected argument 'scenes'"),
        (["--preset", "smoke", "--out", "x", "--external", "theirs"], "expected NAME=DIR"),
        (["--preset", "smoke", "--out", "x", "--external", "modal=."], "that is the name of a row here"),
    ],
)
def test_what_is_refused(arguments, message, capsys):
    assert main(["bench", *arguments]) == 2
    assert message in capsys.readouterr().err


def test_what_fails_is_said_and_the_rest_goes_on(tmp_path, monkeypatch):
    def step(name, code, *needs):
        return PresetStep(name, (sys.executable, "-c", code), needs)

    mark = tmp_path / "mark"
    steps = [
        step("data/a", "raise SystemExit(1)"),
        step("job/a/m", "raise SystemExit('not run')", "data/a"),
        step("data/b", "pass"),
        step("page", f"open({str(mark)!r}, 'w')", "job/a/m", "data/b"),
    ]
    monkeypatch.setattr(presets, "steps_of", lambda *_, **__: steps)
    said: list[str] = []
    assert run_preset("small", tmp_path, say=said.append) == 2
    assert mark.exists()
    assert any("job/a/m: left out, since data/a failed" in line for line in said)


def run_snakemake(folder, config, *more):
    (folder / "config.json").write_text(json.dumps(config))
    command = [snakemake(), "-s", str(SNAKEFILE), "--configfile", "config.json", *more]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(folder / "cache")}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=240)


def test_the_page_is_made_though_a_job_failed_and_a_killed_worker_is_replaced(tmp_path):
    program, log, fail, kill = (tmp_path / name for name in ("python", "calls.txt", "fail", "kill"))
    files = {"log": str(log), "fail": str(fail), "kill": str(kill)}
    program.write_text(STAND_IN.format(python=sys.executable, root=str(ROOT), **files))
    program.chmod(0o755)
    fail.touch()
    config = {"preset": "mic-512", "out": "my bench", "python": str(program)}
    done = run_snakemake(tmp_path, config, "--cores", "1", "--keep-going")
    assert done.returncode == 1
    calls = log.read_text().splitlines()
    assert [" ".join(c.split()[:2]) for c in calls[:-1]] == ["generate mic", *["bench job"] * 3]
    assert calls[-1].startswith("bench scenes ")
    assert calls[-1].endswith(" --collect")
    fail.unlink()
    log.write_text("")
    kill.touch()
    again = run_snakemake(tmp_path, config, "--cores", "2", "--keep-going", "--retries", "1")
    assert again.returncode == 0, again.stderr
    killed, repeated, page = log.read_text().splitlines()
    assert killed == repeated
    assert repeated.startswith("bench job")
    assert " phase-2d " in repeated
    assert page.startswith("bench scenes ")
    assert page.endswith(" --collect")


@pytest.mark.slow
def test_smoke(tmp_path):
    """The benchmark whole, from rendering to the page."""
    pytest.importorskip("bpy")
    command = [sys.executable, "-m", "tg4mm", "bench", "--preset", "smoke", "--out", str(tmp_path / "out")]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run(command, env=environment, check=True, timeout=3000)
    results = json.loads((tmp_path / "out" / "bench" / "results.json").read_text(encoding="utf-8"))
    assert results["failed"] == []
    rows = {line["row"]: line["alphas"]["20"] for line in results["lines"]}
    assert {"nothing moves", "modal", "ceiling", "tracking", "phase-2d"} <= set(rows)
    # few and noisy pictures, little training: a part of the motion that can be shown, which nothing else gets by chance
    assert rows["modal"]["gain"] > 0.2 * rows["ceiling"]["gain"] > 0.1
    assert rows["modal"]["closure"] > 0.2
    assert (tmp_path / "out" / "bench" / "results.html").stat().st_size > 100_000


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
        (["--alphas", "-3"], "-3"),
        (["--alphas", "7"], "ground truth for 5, 20"),
        (["--same-time", "sometimes"], "sometimes"),
        (["--set", "space.colour=1"], "space.colour"),
        (["--set", "space.iterations=-4"], "-4"),
        (["--set", "paper.resolution=100"], "100"),
        (["--set", "motion.iterations=x"], "'x'"),
        (["--external", "a/b=."], "letters, digits"),
        (["--external", "theirs=/nowhere"], "/nowhere is not a folder"),
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
