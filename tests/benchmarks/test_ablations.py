"""benchmarks/ablations.py: every row can be made and trained, no two are the same, and the table holds the figures."""

import argparse
import shlex

import pytest

from benchmarks import ablations
from benchmarks.ablations import ABLATIONS, Row
from dataset_gen.options import parser, request_from
from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.research.bench.request import check_settings
from tg4mm.research.bench.sets import open_set

_SMALL = {
    "space.iterations": "60",
    "space.max_gaussians": "400",
    "space.init_points": "300",
    "motion.components": "1",
}


@pytest.mark.parametrize("name", list(ABLATIONS))
def test_every_row_can_be_made_and_trained_and_no_two_are_the_same(name):
    made = set()
    for row in ABLATIONS[name]:
        check_settings(row.settings, row.preset)
        (settings,) = request_from(parser().parse_args(["mic", "--out", "x", *shlex.split(row.data)])).sets
        made.add((row.label, str(settings.to_json()), str(sorted(row.settings.items()))))
    assert len(made) == len({m[1:] for m in made}) == len(ABLATIONS[name]) > 1


def test_a_table_holds_each_row_and_says_what_fails(tmp_path, monkeypatch, capsys):
    root = tmp_path / "sway_5Hz_0_02"
    make_synthetic_dataset(root, n_views=5, n_timesteps=6, size=32, freqs=(5.0,), alphas=(5,), n_test=1)
    rows = Row("some", _SMALL | {"motion.iterations": "2"}), Row("bad", {"space.iterations": "-1"})
    monkeypatch.setitem(ABLATIONS, "two", rows)
    monkeypatch.setattr(ablations, "_made", lambda given, options: open_set(root, "sway"))
    words = {"names": ["two"], "scene": "sway", "alphas": "5", "options": ""}
    ablations.run(argparse.Namespace(out=tmp_path / "out", **words))
    some, bad = capsys.readouterr().out.strip().splitlines()[-2:]
    cells = [cell.strip() for cell in some.strip("|").split("|")]
    assert cells[0] == "some"
    assert cells[7] == "modal"
    still, ceiling = map(float, cells[-2:])
    assert still < ceiling
    assert bad.startswith("| bad | setting space.iterations is")
