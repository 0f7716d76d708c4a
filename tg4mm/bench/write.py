"""What a benchmark writes: results.json, results.md, plots, tables for LaTeX; and at the end results.html."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tg4mm.bench.folder import write_text
from tg4mm.bench.latex import latex_table
from tg4mm.bench.page import scenes_page
from tg4mm.bench.plots import over_alpha
from tg4mm.bench.tables import groups_of, tables_of
from tg4mm.files import write_json


def write_results(out: Path, results: Mapping[str, Any]) -> None:
    """Write OUT/results.json, results.md, results_<i>.svg and tables/<i>_<name>.tex; <i> counts groups of sets."""
    write_json(out / "results.json", results)
    pictures = {}
    for i, group in enumerate(groups_of(results), 1):
        if (drawn := over_alpha(results, group)) is not None:
            pictures[group] = f"results_{i}.svg"
            write_text(out / pictures[group], drawn)
        for made in tables_of(results, group):
            write_text(out / "tables" / f"{i}_{made.key}.tex", latex_table(made, group))
    write_text(out / "results.md", scenes_page(results, pictures))
