"""A farm's configuration: which datasets, which folders, which commands."""

import io
import json
from pathlib import Path

import pytest

from dataset_gen.errors import GenerateError
from dataset_gen.farm.sets import commands, farm_sets, main
from dataset_gen.options import parser, request_from

SMALL = {"out": "data", "python": "py", "sets": {"mic": None}}


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
