"""The result of a run of the preset `paper`, which says no uncertainty and has a bin for every frequency."""

from __future__ import annotations

from tg4mm.run import Run
from tg4mm.show.result import lines_of, result_of


def test_a_paper_run_has_a_result(trained: Run) -> None:
    found = result_of(trained)
    assert found.agreement == ()
    assert found.noise is None
    lines = lines_of(found)
    assert lines[0].startswith(f"{trained.path}: ")
    assert all(v.amplitude.deviation is None for v in found.vibrations)
    assert "render" in lines[-1]
