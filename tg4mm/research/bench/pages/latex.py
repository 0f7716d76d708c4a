"""Tables in LaTeX for the package booktabs."""

from __future__ import annotations

import re

from tg4mm.research.bench.pages.tables import Table

_ESCAPES = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "α": r"$\alpha$", "×": r"$\times$", "°": r"$^\circ$",
    "±": r"$\pm$", "σ": r"$\sigma$", "δ": r"$\delta$", "−": "$-$", "…": r"\dots{}", "–": "--", "“": "``", "”": "''",
}  # fmt: skip
_PAGE = 45  # rows
_SPECIAL = re.compile("|".join(map(re.escape, _ESCAPES)))


def escaped(text: str) -> str:
    """Text that LaTeX prints as it is."""
    return _SPECIAL.sub(lambda found: _ESCAPES[found.group()], text)


def latex_table(table: Table, where: str = "") -> str:
    """A `table` environment, of more rows than a page has a `longtable`; `where` (the group of sets) ends its title.

    Needs the packages booktabs and longtable.
    """
    columns = "l" * table.text_columns + "r" * (len(table.header) - table.text_columns)
    title = ", ".join(part for part in (table.title, where) if part)
    caption = rf"\caption{{{escaped(title)}. {escaped(table.note)}}}"
    head = [r"\toprule", _row(table.header), r"\midrule"]
    rows = [_row(row) for row in table.rows]
    if len(rows) > _PAGE:
        start = [rf"\begin{{longtable}}{{{columns}}}", rf"{caption} \\", *head, r"\endhead"]
        lines = [*start, *rows, r"\bottomrule", r"\end{longtable}"]
    else:
        start = [r"\begin{table}", r"\centering", caption, rf"\begin{{tabular}}{{{columns}}}"]
        lines = [*start, *head, *rows, r"\bottomrule", r"\end{tabular}", r"\end{table}"]
    return "\n".join(lines) + "\n"


def _row(cells: list[str]) -> str:
    return " & ".join(map(escaped, cells)) + r" \\"
