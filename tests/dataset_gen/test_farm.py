"""A farm's configuration, and its Snakemake workflow: with a stand-in for the generator and, slowly, with it.

Snakemake is looked for in $TG4MM_SNAKEMAKE, beside this Python, and on PATH. Slurm cannot be tested here;
what can is that the workflow is accepted with its profile where the plugin is installed.
"""

import io
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from dataset_gen.errors import GenerateError
from dataset_gen.farm.sets import commands, farm_sets, main
from dataset_gen.options import parser, request_from
from tests.helpers.snakemake_program import FARM, check_plugins, snakemake

SMALL = {"out": "data", "python": "py", "sets": {"mic": None}}
ROOT = FARM.parent.parent

# Keeps to the generator's own command line and its files, renders nothing. A file `fail` makes the part it names fail.
STAND_IN = """#!{python}
import os, runpy, shutil, sys
sys.path.insert(0, {root!r})
from pathlib import Path
if sys.argv[2] != "dataset_gen":
    sys.argv = sys.argv[2:]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
    sys.exit()
from dataset_gen.options import parser, request_from
request = request_from(parser().parse_args(sys.argv[3:]))
root = request.out / request.sets[0].folder
what = "prepare" if request.prepare else "finish" if request.finish else "%d/%d" % request.part
with open({log!r}, "a") as log:
    log.write(root.name + " " + what + "\\n")
if request.prepare:
    if root.exists() and any(root.iterdir()) and not (root / "scene.json").exists():
        sys.exit("not empty and holds no scene.json")
    (root / ".parts").mkdir(parents=True, exist_ok=True)
    (root / "scene.json").write_text("{{}}")
    (root / ".parts/parts.json").write_text("{{}}")
elif request.part:
    if not (root / "scene.json").exists():
        sys.exit("not prepared")
    fail = Path({fail!r})
    if fail.exists() and fail.read_text() == what:
        sys.exit("this part fails")
    (root / ".parts" / (what.replace("/", "_of_") + ".done")).touch()
else:
    if len(list(root.glob(".parts/*.done"))) != 3:
        sys.exit("not all parts are done")
    shutil.rmtree(root / ".parts")
    (root / "report").mkdir(exist_ok=True)
    (root / "report/index.html").write_text("done")
"""


def test_every_command_is_one_that_the_generator_understands():
    made = commands("py", ["mic", "--size", "64"], "my data", 3, 2)
    requests = [
        request_from(parser().parse_args(list(c[3:]))) for c in (made.prepare, *made.parts, made.finish)
    ]
    assert all(c[:3] == ("py", "-m", "dataset_gen") for c in (made.prepare, *made.parts, made.finish))
    assert {r.out for r in requests} == {Path("my data")}
    assert {r.sets[0].folder for r in requests} == {"mic_5Hz_0_005"}
    assert (requests[0].prepare, requests[0].parts) == (True, 3)
    assert [(r.part, r.count) for r in requests[1:4]] == [((1, 3), 2), ((2, 3), 2), ((3, 3), 2)]
    assert requests[4].finish


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"out": "data"}, "sets is missing"),
        ({**SMALL, "out": ""}, "out is missing"),
        ({**SMALL, "size": 3}, "'size' is not one of"),
        ({**SMALL, "parts": "4"}, "parts is '4'"),
        ({**SMALL, "parts": True}, "parts is True"),
        ({**SMALL, "threads": 0}, "threads is 0"),
        ({**SMALL, "sets": {"mic": 3}}, "set 'mic': is 3"),
        ({**SMALL, "sets": {"mic": {"size": 3}}}, "'size' is not one of options, parts"),
        ({**SMALL, "sets": {"mic": {"parts": 0}}}, "parts is 0"),
        ({**SMALL, "sets": {"mic": {"parts": 3.1}}}, "parts is 3.1"),
        ({**SMALL, "parts": 9 * 10**15}, "parts is 9000000000000000, expected 1 to 100,000"),
        ({**SMALL, "mem_mb": 9 * 10**15}, "mem_mb is 9000000000000000, expected 1 to"),
        ({**SMALL, "python": "-h"}, "python is '-h'"),
        ({**SMALL, "sets": {"mic": {"parts": 9 * 10**15}}}, "parts is 9000000000000000"),
        ({**SMALL, "sets": {"mic": {"options": "mic -h"}}}, "ask for help"),
        ({**SMALL, "out": "x\0"}, "control character"),
        ({**SMALL, "sets": {"mic": {"options": 5}}}, "options is 5"),
        ({**SMALL, "sets": {"mice": None}}, "'mice' is not one of"),
        ({**SMALL, "sets": {"mic": {"options": "mic --size 3x"}}}, "set 'mic': .*'3x'"),
        ({**SMALL, "sets": {"mic": {"options": "mic 'open"}}}, "set 'mic': No closing quotation"),
        ({**SMALL, "sets": {"all": None}}, "name each as a set of its own"),
        ({**SMALL, "sets": {"mic": {"options": "mic --finish"}}}, "which the farm adds"),
        ({**SMALL, "sets": {"mic": None, "same": {"options": "mic"}}}, "have the same folder mic_5Hz_0_005"),
    ],
)
def test_a_bad_configuration_is_refused_with_one_line(config, message):
    with pytest.raises(GenerateError, match=message) as caught:
        farm_sets(config)
    assert "\n" not in str(caught.value)


def test_the_module_prints_what_a_shell_can_run(monkeypatch, capsys):
    config = {**SMALL, "out": "my data", "parts": 2}
    monkeypatch.setattr("sys.stdin", io.StringIO(json.dumps(config)))
    assert main() == 0
    ((folder, plan),) = json.loads(capsys.readouterr().out).items()
    assert folder == "mic_5Hz_0_005"
    assert plan["prepare"] == "py -m dataset_gen mic --out 'my data' --prepare --parts 2"
    assert plan["part"][1] == "py -m dataset_gen mic --out 'my data' --part 2/2 --processes 1"
    monkeypatch.setattr("sys.stdin", io.StringIO("[]"))
    assert main() == 2
    assert capsys.readouterr().err == "error: configuration is [], expected an object\n"


class Farm:
    """A folder with a configuration, and Snakemake started in it."""

    def __init__(self, folder, python, sets, options=""):
        self.folder, self.out = folder, folder / "my sets"
        config = {"out": str(self.out), "python": python, "parts": 3, "options": options, "sets": sets}
        (folder / "config.json").write_text(json.dumps(config))

    def run(self, *more, seconds=240):
        command = [snakemake(), "-s", str(FARM / "Snakefile"), "--configfile", "config.json", *more]
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(self.folder / "cache")}
        return subprocess.run(
            command, cwd=self.folder, env=environment, capture_output=True, text=True, timeout=seconds
        )


class StandIn(Farm):
    """A farm whose Python records what it was asked for."""

    def __init__(self, folder, sets):
        self.log, self.fail = folder / "calls.txt", folder / "fail"
        program = folder / "python"
        program.write_text(
            STAND_IN.format(python=sys.executable, root=str(ROOT), log=str(self.log), fail=str(self.fail))
        )
        program.chmod(0o755)
        super().__init__(folder, str(program), sets)

    def calls(self):
        """What was run since the last time, in order."""
        found = self.log.read_text().splitlines() if self.log.exists() else []
        self.log.write_text("")
        return found


@pytest.fixture
def farm(tmp_path):
    return StandIn(tmp_path, {"mic": None})


def test_every_step_runs_once_and_a_finished_set_is_left_alone(farm):
    done = farm.run("--cores", "2")
    assert done.returncode == 0, done.stderr
    calls = [call.split()[1] for call in farm.calls()]
    assert calls[0] == "prepare"
    assert sorted(calls[1:4]) == ["1/3", "2/3", "3/3"]
    assert calls[4:] == ["finish"]
    assert (farm.out / "mic_5Hz_0_005/report/index.html").is_file()
    again = farm.run("--cores", "2")
    assert again.returncode == 0, again.stderr
    assert "Nothing to be done" in again.stderr
    assert farm.calls() == []


@pytest.mark.slow
def test_a_part_that_failed_is_all_that_runs_again(farm):
    farm.fail.write_text("2/3")
    done = farm.run("--cores", "1", "--keep-going")
    assert done.returncode == 1
    assert farm.calls()[-1].split()[1] != "finish"
    assert "this part fails" in (farm.out / ".log/mic_5Hz_0_005/2_of_3.txt").read_text()
    farm.fail.unlink()
    again = farm.run("--cores", "1")
    assert again.returncode == 0, again.stderr
    assert [call.split()[1] for call in farm.calls()] == ["2/3", "finish"]


@pytest.mark.parametrize("name", ["local", "slurm"])
def test_the_profiles_are_accepted(farm, name):
    done = farm.run("--profile", str(FARM / "profiles" / name), "--dry-run")
    said = done.stdout + done.stderr
    check_plugins(said, name)
    assert done.returncode == 0, said
    assert "3_of_3.done" in said


@pytest.mark.slow
def test_the_generator_itself_is_run_in_parts(tmp_path):
    pytest.importorskip("bpy")
    options = (
        "--preset smoke --size 16 --timesteps 2 --samples 1 --views 3 --test-views 1 --points 20 --alphas 5"
    )
    farm = Farm(tmp_path, sys.executable, {"mic": None}, options)
    done = farm.run("--cores", "1", seconds=560)
    assert done.returncode == 0, done.stderr
    root = farm.out / "mic_5Hz_0_005"
    assert (root / "001/train/r_001.png").is_file()
    assert (root / "magnified/x005/001/test/r_000.png").is_file()
    assert (root / "report/index.html").is_file()
    assert (root / "points3d.ply").is_file()
    assert not (root / ".parts").exists()
