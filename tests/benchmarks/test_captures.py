"""benchmarks/captures.py: its sets are ones that the generator makes, and its table says what is there."""

import pytest

from benchmarks.captures import EFFECTS, KINDS, cases, finish
from dataset_gen.options import parser, request_from


def every(tmp_path):
    return list(cases(tmp_path, ["mic", "chair"], list(KINDS), list(EFFECTS)))


def test_every_case_is_a_set_that_the_generator_takes(tmp_path):
    made = every(tmp_path)
    assert len(made) == 2 * len(KINDS) + len(EFFECTS)
    assert len({case.folder for case in made}) == len(made)
    for case in made:
        (settings,) = request_from(parser().parse_args([case.scene, "--out", "x", *case.options])).sets
        assert settings.effects.any == (case.name.startswith("orbit") and case.name.split()[-1] not in _CLEAN)
    kinds = {
        request_from(parser().parse_args(["mic", "--out", "x", *o])).sets[0].cameras.capture_kind
        for o in KINDS.values()
    }
    assert kinds == {"rig", "tripod", "handheld", "clips"}


_CLEAN = ("none", "sensor", "jpeg")  # what a sensor does is no effect of a record


def test_a_case_that_is_done_is_left_alone_and_a_failed_one_says_why(tmp_path, monkeypatch):
    case = every(tmp_path)[0]
    assert finish(case, ["--size", "7"], [], []) == "error: --size 7 is not a whole number in 8 … 4096"
    case.metrics.parent.mkdir(parents=True)
    case.metrics.write_text("{}")
    monkeypatch.setattr("benchmarks.captures._run", lambda command: pytest.fail("it ran again"))
    assert finish(case, [], [], []) == ""
