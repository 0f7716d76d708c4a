"""Markdown tables whose columns line up, so that they read well on a terminal too."""

from __future__ import annotations

from collections.abc import Sequence

NOTHING = "–"


def shown(value: float | None, form: str) -> str:
    """A number by a format such as `{:.4f}`, a dash where there is none."""
    return NOTHING if value is None else form.format(value)


def table(header: Sequence[str], rows: Sequence[Sequence[str]], text_columns: int = 1) -> str:
    """Markdown lines: the first `text_columns` columns flush left, the numbers flush right. Ends without a newline."""
    cells = [[_cell(c) for c in row] for row in (header, *rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(header))]
    sides = ["<" if i < text_columns else ">" for i in range(len(header))]

    def line(row: Sequence[str]) -> str:
        return "| " + " | ".join(f"{c:{s}{w}}" for c, s, w in zip(row, sides, widths, strict=True)) + " |"

    dashes = (
        f":{'-' * (w + 1)}" if s == "<" else f"{'-' * (w + 1)}:" for s, w in zip(sides, widths, strict=True)
    )
    return "\n".join([line(cells[0]), "|" + "|".join(dashes) + "|", *map(line, cells[1:])])


def _cell(text: str) -> str:
    return " ".join(str(text).split()).replace("|", "\\|")
