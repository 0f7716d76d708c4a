"""Tables as text: Markdown whose columns line up on a terminal too, and LaTeX for the package booktabs."""

from collections.abc import Sequence
from dataclasses import dataclass

NOTHING = "–"
_ESCAPES = {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "α": r"$\alpha$",
    "×": r"$\times$", "°": r"$^\circ$", "±": r"$\pm$", "σ": r"$\sigma$", "δ": r"$\delta$", "−": "$-$", "…": r"\dots{}",
    "–": "--", "“": "``", "”": "''", **{mark: f"\\{mark}" for mark in "&%$#_{}"},
}  # fmt: skip


@dataclass(frozen=True)
class TextTable:
    """Cells as text; the first `text_columns` are words, the others numbers."""

    key: str  # a file's name
    title: str
    note: str
    header: list[str]
    rows: list[list[str]]
    text_columns: int = 1


def escaped(text: str) -> str:
    """Text that LaTeX prints as it is."""
    return "".join(_ESCAPES.get(mark, mark) for mark in text)


def latex_table(table: TextTable, where: str = "") -> str:
    """A `longtable` of the packages booktabs and longtable; `where` (the group of sets) ends its title."""
    columns = "l" * table.text_columns + "r" * (len(table.header) - table.text_columns)
    title = ", ".join(part for part in (table.title, where) if part)
    head, *rows = (" & ".join(map(escaped, row)) + r" \\" for row in (table.header, *table.rows))
    lines = [
        rf"\begin{{longtable}}{{{columns}}}",
        rf"\caption{{{escaped(title)}. {escaped(table.note)}}} \\",
        *(r"\toprule", head, r"\midrule", r"\endhead"),
        *rows,
        *(r"\bottomrule", r"\end{longtable}"),
    ]
    return "\n".join(lines) + "\n"


def shown(value: float | None, form: str) -> str:
    """A number by a format such as `{:.4f}`, a dash where there is none."""
    return NOTHING if value is None else form.format(value)


def table(
    header: Sequence[str], rows: Sequence[Sequence[str]], text_columns: int = 1, numbers_first: int = 0
) -> str:
    """Return Markdown lines of a table, without a final newline.

    After `numbers_first` columns of numbers come `text_columns` flush left; the rest is flush right.
    """
    cells = [[_cell(c) for c in row] for row in (header, *rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(header))]
    sides = ["<" if 0 <= i - numbers_first < text_columns else ">" for i in range(len(header))]

    def line(row: Sequence[str]) -> str:
        return "| " + " | ".join(f"{c:{s}{w}}" for c, s, w in zip(row, sides, widths, strict=True)) + " |"

    dashes = (
        f":{'-' * (w + 1)}" if s == "<" else f"{'-' * (w + 1)}:" for s, w in zip(sides, widths, strict=True)
    )
    return "\n".join([line(cells[0]), "|" + "|".join(dashes) + "|", *map(line, cells[1:])])


def _cell(text: str) -> str:
    return " ".join(str(text).split()).replace("|", "\\|")
