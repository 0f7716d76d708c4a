"""Tables of numbers as programs and data loggers write them."""

import csv
from pathlib import Path

import numpy as np

from tg4mm.core.errors import Tg4mmError

_MOST_BYTES = 1 << 30
_COMMENTS = ("#", "%", "//")
_ENCODINGS = ("utf-8-sig", "cp1252")


class AnalyseError(Tg4mmError):
    """A record that cannot be read or does not hold what is asked of it."""


def read_table(path: Path) -> tuple[list[str], np.ndarray]:
    """Head and numbers [rows, columns] of a CSV file; values between commas, semicolons or tabs.

    Lines before the head, comments, a row of units below the head, and decimal commas are understood. Raises
    AnalyseError for anything else.
    """
    if not path.is_file():
        raise AnalyseError(f"{path} does not exist")
    if path.stat().st_size > _MOST_BYTES:
        raise AnalyseError(f"{path} is larger than {_MOST_BYTES >> 30} GiB")
    rows = _rows(path)
    first = next((k for k in range(1, len(rows)) if _is_of_numbers(rows[k][1])), 1)
    if len(rows) < 2:
        raise AnalyseError(f"{path} holds no rows below a head")
    number, head = rows[first - 1]
    width = len(head)
    if first > 1 and len(rows[first - 2][1]) == width > 1 and _is_of_units(head):
        head = [
            f"{name} [{unit.strip().strip('[]()')}]"
            for name, unit in zip(rows[first - 2][1], head, strict=True)
        ]
    for number, row in rows[first:]:
        if len(row) != width:
            raise AnalyseError(f"{path}, row {number}: {len(row)} values, expected {width}")
    try:
        table = np.array([row for _, row in rows[first:]], float)
    except ValueError as error:
        raise AnalyseError(f"{path}: {error}") from None
    if not np.isfinite(table).all():
        number = rows[first + int(np.argwhere(~np.isfinite(table))[0, 0])][0]
        raise AnalyseError(f"{path}, row {number}: not a finite number")
    return head, table


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Line numbers and values; of comments the last one before the numbers, where it is their head."""
    lines = [(k, line) for k, line in enumerate(_text(path).splitlines(), 1) if line.strip()]
    own = [(k, line) for k, line in lines if not line.lstrip().startswith(_COMMENTS)]
    last = own[-1][1] if own else ""
    mark = next((mark for mark in (";", "\t") if mark in last), ",")
    if own and _is_of_numbers(_decimals(own[0][1].split(mark), mark)):
        own = [(k, line.lstrip().lstrip("#%/ ")) for k, line in lines if k < own[0][0]][-1:] + own
    try:
        values = csv.reader((line for _, line in own), delimiter=mark, skipinitialspace=True)
        return [(k, _decimals(row, mark)) for (k, _), row in zip(own, values, strict=True)]
    except (csv.Error, ValueError) as error:
        raise AnalyseError(f"{path} is no CSV file: {error}") from None


def _decimals(row: list[str], mark: str) -> list[str]:
    """Values with decimal points, where commas do not part them; a mark at the end of a line parts nothing."""
    row = row[:-1] if len(row) > 1 and not row[-1].strip() else row
    points = [value.replace(",", ".") for value in row]
    return (
        row if mark == "," else [p if _is_number(p) else value for p, value in zip(points, row, strict=True)]
    )


def _text(path: Path) -> str:
    data = path.read_bytes()
    encodings = ("utf-16",) if data.startswith((b"\xff\xfe", b"\xfe\xff")) else _ENCODINGS
    if b"\0" in data and encodings == _ENCODINGS:
        raise AnalyseError(f"{path} is no CSV file: it holds null bytes")
    for encoding in encodings:
        try:
            return data.decode(encoding)
        except UnicodeDecodeError as error:
            last = error
    raise AnalyseError(f"{path} is no CSV file: {last}") from None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _is_of_numbers(row: list[str]) -> bool:
    return all(map(_is_number, row))


def _is_of_units(row: list[str]) -> bool:
    """Whether a row below names says nothing but units: the first, of times, is one of seconds."""
    return row[0].strip().strip("[]()").lower() in ("s", "ms", "us", "µs", "sec", "seconds")
