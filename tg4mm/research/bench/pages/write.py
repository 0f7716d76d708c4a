"""What a benchmark writes: results.json, results.md, plots, tables for LaTeX; and at the end results.html."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tg4mm.core.files import write_json
from tg4mm.research.bench.folder import write_text
from tg4mm.research.bench.pages.latex import latex_table
from tg4mm.research.bench.pages.markdown import scenes_page
from tg4mm.research.bench.pages.plots import over_alpha, size_and_speed
from tg4mm.research.bench.pages.tables import full_table, groups_of, kinds_tables, tables_of


def write_results(out: Path, results: Mapping[str, Any]) -> None:
    """Write OUT/results.json, results.md, results_<i>.svg, results_<i>_size.svg, and tables/<i>_<name>.tex, kinds.tex.

    <i> counts groups of sets. The second drawing is as [TG4MM] Fig. 6.
    """
    write_json(out / "results.json", results)
    before = {*out.glob("results_*.svg"), *(out / "tables").glob("*.tex")}
    pictures: dict[str, dict[str, str]] = {}
    for i, group in enumerate(groups_of(results), 1):
        drawings = {
            f"results_{i}.svg": ("SSIM and closure over magnification", over_alpha(results, group)),
            f"results_{i}_size.svg": ("Size of the model and speed", size_and_speed(results, group)),
        }
        for name, (title, drawn) in drawings.items():
            if drawn is not None:
                pictures.setdefault(group, {})[name] = f"{title}, {group}"
                write_text(out / name, drawn)
                before.discard(out / name)
        for made in (*tables_of(results, group), full_table(results, group)):
            file = out / "tables" / f"{i}_{made.key}.tex"
            write_text(file, latex_table(made, group))
            before.discard(file)
    for made in kinds_tables(results):
        write_text(out / "tables" / f"{made.key}.tex", latex_table(made))
        before.discard(out / "tables" / f"{made.key}.tex")
    for old in before:
        old.unlink()  # of methods or groups that are in the results no more
    write_text(out / "results.md", scenes_page(results, pictures))
