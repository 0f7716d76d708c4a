"""The Flamenco job type, run in an ES5.1 interpreter with a stand-in for the manager's `author` module.

The stand-in keeps to what the manager does: a task is copied when it is added to the job, so what is attached
to it later is lost. A manager and workers cannot be tested here.
"""

import json
from pathlib import Path

import pytest

import dataset_gen.farm
from dataset_gen.farm.sets import commands

dukpy = pytest.importorskip(
    "dukpy", reason="dukpy, a JavaScript interpreter, is not installed: pip install dukpy"
)

SCRIPT = Path(dataset_gen.farm.__file__).parent / "tg4mm_dataset.js"
MANAGER = """
var author = {
    Task: function (name, type) {
        var task = { name: name, type: type, commands: [], dependencies: [] };
        task.addCommand = function (command) { task.commands.push(command); };
        task.addDependency = function (other) { task.dependencies.push(other.name); };
        return task;
    },
    Command: function (name, parameters) { return { name: name, parameters: parameters }; }
};
var job = {
    settings: dukpy.settings, tasks: [],
    addTask: function (task) { this.tasks.push(JSON.parse(JSON.stringify(task))); }
};
"""
SETTINGS = {"scene": "mic", "options": "", "out": "/data", "parts": 3, "python": "py", "processes": 0}


def job_type():
    return json.loads(dukpy.evaljs([SCRIPT.read_text(), "JSON.stringify(JOB_TYPE)"]))


def compiled(**settings):
    defaults = {s["key"]: s["default"] for s in job_type()["settings"] if "default" in s}
    code = [MANAGER, SCRIPT.read_text(), "compileJob(job); JSON.stringify(job.tasks)"]
    return json.loads(dukpy.evaljs(code, settings={**defaults, **SETTINGS, **settings}))


def command_lines(tasks):
    found = []
    for task in tasks:
        (command,) = task["commands"]
        assert command["name"] == "exec"
        assert set(command["parameters"]) == {"exe", "args"}
        found.append((command["parameters"]["exe"], *command["parameters"]["args"]))
    return found


@pytest.mark.parametrize("parts", [1, 3, 12])
def test_the_commands_are_those_of_every_other_farm(parts):
    tasks = compiled(parts=parts, processes=2, options="--preset paper --amplitude 0.02")
    arguments = ["mic", "--preset", "paper", "--amplitude", "0.02"]
    expected = commands("py", arguments, "/data", parts, 2)
    assert command_lines(tasks) == [expected.prepare, *expected.parts, expected.finish]


def test_parts_wait_for_the_preparation_and_the_end_for_all_parts():
    tasks = compiled()
    assert [task["name"] for task in tasks] == ["prepare", "render-1/3", "render-2/3", "render-3/3", "finish"]
    assert [task["dependencies"] for task in tasks] == [
        [],
        ["prepare"],
        ["prepare"],
        ["prepare"],
        ["render-1/3", "render-2/3", "render-3/3"],
    ]
    assert [task["type"] for task in tasks] == ["misc", "blender", "blender", "blender", "misc"]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"parts": 0}, "parts is 0"),
        ({"parts": 2.5}, "parts is 2.5"),
        ({"scene": "", "motion": "/m.yaml"}, "name a scene, or save"),
        ({"scene": "", "blendfile": "/a.blend"}, "motion is empty"),
        ({"options": "--name 'a"}, "quote ' is not closed"),
    ],
)
def test_what_cannot_be_rendered_is_refused(settings, message):
    with pytest.raises(dukpy.JSRuntimeError, match=message):
        compiled(**settings)
