"""benchmarks/beside.py: two checkouts' commands run in turn, each in its own code and folder, and are compared."""

import pytest

from benchmarks.__main__ import main
from benchmarks.beside import table
from benchmarks.common import Cost

PROGRAM = """
import os, sys
from pathlib import Path
import tg4mm
out = Path(sys.argv[2])
assert sys.argv[1] == "process" and not out.exists()
out.mkdir()
with open({log!r}, "a") as log:
    print(Path(tg4mm.__file__).parents[1].name, os.environ.get("NUMBA_CACHE_DIR") is not None, out, file=log)
"""


@pytest.fixture
def checkouts(tmp_path, monkeypatch):
    """Two checkouts whose program notes who was called; the second is the one that measures."""
    log = tmp_path / "log"
    for name in ("old", "new"):
        (tmp_path / name / "tg4mm").mkdir(parents=True)
        (tmp_path / name / "tg4mm" / "__init__.py").touch()
        (tmp_path / name / "tg4mm" / "__main__.py").write_text(PROGRAM.format(log=str(log)))
    monkeypatch.setattr("tg4mm.__file__", str(tmp_path / "new" / "tg4mm" / "__init__.py"))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    return tmp_path / "old", log


@pytest.mark.parametrize(("option", "calls"), [([], 3), (["--fresh"], 2)])
def test_both_run_in_turn_in_folders_that_are_new_and_go(checkouts, capsys, option, calls):
    old, log = checkouts
    assert main(["beside", "--turns", "2", *option, str(old), "--", "process", "OUT"]) == 0
    said = [line.split() for line in log.read_text().splitlines()]
    assert [line[0] for line in said] == ["old", "new"] * calls
    assert {line[1] for line in said} == {str(bool(option))}
    assert len({line[2] for line in said}) == len(said)
    printed = capsys.readouterr().out
    assert printed.count("not counted") == (0 if option else 2)
    assert "| processor s |" in printed


def test_a_command_that_fails_stops_it_with_its_words(checkouts, capsys):
    old, _ = checkouts
    assert main(["beside", str(old), "--", "measure", "OUT"]) == 2
    assert "AssertionError" in capsys.readouterr().err
    assert main(["beside", str(old)]) == 2
    assert main(["beside", str(old.parent), "--", "process", "OUT"]) == 2


def test_the_table_has_medians_and_their_ratio():
    costs = {"before": [Cost(9, 5, 2), Cost(1, 5, 2), Cost(4, 5, 2)], "after": [Cost(1, 5, 1)] * 3}
    assert "| processor s | 4 | 1 | 0.25 |" in table(costs)
    assert "| GiB | 2 | 1 | 0.50 |" in table(costs)
