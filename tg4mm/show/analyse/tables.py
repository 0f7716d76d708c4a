"""Tables of numbers in text files of other programs: separators, heads, decimal marks, missing values, and times.

`timed` finds which column holds times, in what unit, and which values belong to them.
"""

import csv
import logging
import re
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.even_clock import is_filled

MOST_BYTES = 1 << 30
_LOG = logging.getLogger("tg4mm")
_COMMENTS = ("#", "%", "//")
_ENCODINGS = ("utf-8-sig", "cp1252")
_MARKS = (";", "\t", ",", None)  # None: blanks
_LOOKED_AT = 20  # rows from a file's middle on, which tell its separator and what its columns hold
_MISSING = {"", "nan", "na", "n/a", "null", "none", "-", "--"}
_GROUPS = "'’ \u00a0\u202f"  # marks of thousands that are never decimal marks
_NUMBER = re.compile(
    rf"[-+]?(?=[.,]?\d)(?:\d{{1,3}}([.,{_GROUPS}])\d{{3}}(?:\1\d{{3}})*|\d*)(?:[.,]\d*)?(?:[eEdD][-+]?\d+)?"
)
_THOUSANDS = {mark: re.compile(rf"[-+]?[1-9]\d{{0,2}}(\{mark}\d{{3}})+") for mark in ".,"}
_CLOCK = re.compile(
    r"(?:.*[T\s])?(?:(\d{1,2}):)?(\d{1,2}):(\d{1,2}(?:[.,:]\d+)?)\s*([ap]\.?m\.?)?\s*(?:Z|[-+]\d\d:?\d\d)?",
    re.I,
)
_Item = TypeVar("_Item")
# of a LabVIEW measurement file: its column of times, which may be empty, and their step, start and the others' unit
_TIMES, _STEP, _START, _UNIT = "X_Value", "Delta_X", "X0", "Y_Unit_Label"
FEWEST = 16  # samples of a channel
TIME_UNITS = {
    "s": 1.0, "ss": 1.0, "second": 1.0, "seconds": 1.0, "secs": 1.0, "ms": 1e-3, "milliseconds": 1e-3,
    "us": 1e-6, "microseconds": 1e-6, "ns": 1e-9, "nanoseconds": 1e-9, "min": 60.0, "minutes": 60.0, "h": 3600.0,
}  # fmt: skip
_NAMES = {
    *(
        "t",
        "time",
        "times",
        "second",
        "seconds",
        "sec",
        "secs",
        "timestamp",
        "time stamp",
        "datetime",
        "date/time",
    ),
    *("date time", "elapsed", "elapsed time", "time elapsed", "seconds elapsed", "relative time", "x value"),
    *("zeit", "zeitstempel", "uhrzeit", "temps", "tiempo", "tempo", "tijd"),
}
_INDICES = {"sample", "samples", "index", "no", "no.", "nr", "nr.", "n", "#", "row", "frame", "point", ""}
_SINCE_1970 = 9e8, 5e9  # seconds, of times from 1998 to 2128


class AnalyseError(Tg4mmError):
    """A record that cannot be read or does not hold the requested data."""


def read_table(path: Path) -> tuple[list[str], np.ndarray]:
    """Read the head and the numbers [rows, columns] of a text file; a missing value is NaN.

    Values lie between commas, semicolons, tabs or blanks. Lines before the head, comments, a row of units below the
    head, decimal commas, marks of thousands, and lines after the numbers are understood. Times of day become seconds;
    columns of other texts are left out, with a warning. Names of a file without a head are empty. Raises AnalyseError
    for anything else.
    """
    if not path.is_file():
        raise AnalyseError(f"{path} does not exist")
    if path.stat().st_size > MOST_BYTES:
        raise AnalyseError(f"{path} is larger than {MOST_BYTES >> 30} GiB")
    rows = _rows(path)
    looked_at = [row for _, row in _middle(rows)]
    width = Counter(map(len, looked_at)).most_common(1)[0][0] if looked_at else 0
    kinds = [_kind_of([row[c] for row in looked_at if len(row) == width]) for c in range(width)]
    first = _first_of(path, rows, kinds)
    body = rows[first:]
    while body and not _holds_any(body[-1][1], kinds):
        body.pop()
    if not body:
        raise AnalyseError(f"{path} holds no rows below a header")
    if left := len(rows) - first - len(body):
        _LOG.warning(f"{path}: its last lines hold no numbers: {left} left out, from row {rows[-left][0]} on")
    for number, row in body:
        if len(row) < width or any(cell.strip() for cell in row[width:]):
            raise AnalyseError(f"{path}, row {number}: {len(row)} values, expected {width}")
    return _columns(path, _head(rows[:first], width), body, dict(_preamble(rows[:first])))


def _first_of(path: Path, rows: list[tuple[int, list[str]]], kinds: list[str]) -> int:
    """Return where the table begins: after the last row of its first half that holds other things than its middle."""
    holds = [_holds_values(row, kinds) for _, row in rows[: len(rows) // 2 + 1]]
    first = next((k + 1 for k in reversed(range(len(holds))) if not holds[k]), 0)
    first = (
        first
        if first < len(holds)
        else next((k for k in range(first, len(rows)) if _holds_values(rows[k][1], kinds)), first)
    )
    if sum(holds[:first]) > first / 2:
        number, row = rows[first - 1]
        if len(row) != len(kinds):
            raise AnalyseError(f"{path}, row {number}: {len(row)} values, expected {len(kinds)}")
        raise AnalyseError(f"{path}, row {number}: {', '.join(row)}: is no row of numbers")
    return first


def _columns(
    path: Path, head: list[str], body: list[tuple[int, list[str]]], preamble: dict[str, str]
) -> tuple[list[str], np.ndarray]:
    """Return the names and numbers of the columns that hold numbers."""
    names, columns, texts = list[str](), list[np.ndarray](), list[str]()
    cells = [[row[c].strip() for _, row in body] for c in range(len(head))]
    marks = [_decimal_mark(column) for column in cells]
    usual = next((mark for mark in ",." if mark in marks), None)
    for name, column, mark in zip(head, cells, marks, strict=True):
        kind = _kind_of(_middle(column))
        kind = kind if kind != "empty" else _kind_of(column)
        if kind == "empty" and name == _TIMES and _STEP in preamble:
            step, start = (float(preamble.get(key, "0").replace(",", ".")) for key in (_STEP, _START))
            values = start + step * np.arange(len(column))
        elif kind == "number":
            values = _numbers(path, body, column, mark or usual)
        elif kind == "clock":
            values, name = _seconds_of_day(path, body, column), re.sub(r"\s*[\[(].*", "", name) + " [s]"
        else:
            texts += [name] if name and kind == "text" else []
            continue
        names.append(name)
        columns.append(values)
    if not columns:
        raise AnalyseError(f"{path} holds no rows below a header")
    if texts:
        _LOG.warning(f"{path}: columns without numbers are left out: {', '.join(texts)}")
    table = np.stack(columns, 1)
    if np.isinf(table).any():
        number = body[int(np.argwhere(np.isinf(table))[0, 0])][0]
        raise AnalyseError(f"{path}, row {number}: not a finite number")
    return names, table


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Return line numbers and values; the last comment before the numbers counts if it is their head."""
    lines = [(k, line) for k, line in enumerate(_text(path).splitlines(), 1) if line.strip()]
    own = [(k, line) for k, line in lines if not line.lstrip().startswith(_COMMENTS)]
    middle = _middle(own)

    def fit(mark: str | None) -> tuple[int, ...]:
        parts = [_split(line, mark) for _, line in middle]
        whole = sum(len(row) > 1 and all(_is_value(c) or _is_missing(c) for c in row) for row in parts)
        occurs = mark is None or any(mark in line for _, line in middle)
        return whole, sum(_is_value(cell) for row in parts for cell in row), occurs

    mark = max(_MARKS, key=fit)
    width = max((len(_split(line, mark)) for _, line in middle), default=0)
    if own and all(map(_is_value, _split(own[0][1], mark))):
        own = [(k, line.lstrip().lstrip("#%/ ")) for k, line in lines if k < own[0][0]][-1:] + own
    try:
        if mark is None:
            return [(k, _split(line, None, width)) for k, line in own]
        values = csv.reader((line for _, line in own), delimiter=mark, skipinitialspace=True)
        return [(k, row) for (k, _), row in zip(own, values, strict=True)]
    except (csv.Error, ValueError) as error:
        raise AnalyseError(f"{path} is not a CSV file: {error}") from None


def _middle(rows: Sequence[_Item]) -> Sequence[_Item]:
    return rows[max(len(rows) - 1, 0) // 2 :][:_LOOKED_AT]


def _split(line: str, mark: str | None, width: int = 0) -> list[str]:
    """Return a line's cells; of a head between blanks, whose names and units may hold blanks, `width` if possible."""
    if mark is not None:
        return next(csv.reader([line], delimiter=mark, skipinitialspace=True), [])
    forms = (
        line.split(),
        re.split(r"\s{2,}|\t", line.strip()),
        re.findall(r"[^\s\[(]+\s*[\[(][^\])]*[\])]|\S+", line),
    )
    return next((cells for cells in forms if len(cells) == width), forms[0])


def _preamble(rows: list[tuple[int, list[str]]]) -> list[tuple[str, str]]:
    return [(row[0].strip(), row[1].strip()) for _, row in rows if len(row) > 1]


def _head(rows: list[tuple[int, list[str]]], width: int) -> list[str]:
    """Return `width` names, with their units where these are a row of their own; empty ones where there is no head."""
    names = [cell.strip() for cell in rows[-1][1]] if rows else []
    above = rows[-2][1] if len(rows) > 1 else []
    if len(above) == len(names) > 1 and _is_of_units(names):
        names = [f"{name} [{unit.strip('[]()')}]" for name, unit in zip(above, names, strict=True)]
    elif len(names) == 1 < width:  # a title
        names = []
    unit = dict(_preamble(rows)).get(_UNIT, "")
    names = [f"{name} [{unit}]" if unit and name != _TIMES else name for name in names]
    return (names + [""] * width)[:width]


def _is_of_units(row: list[str]) -> bool:
    """Return whether a row below names says nothing but units: the first, of times, is one of seconds."""
    return row[0].strip().strip("[]()").lower() in ("s", "ms", "us", "µs", "ns", "sec", "seconds")


def _kind_of(cells: Sequence[str]) -> str:
    """Return the kind of most of a column's cells: number, clock (times of day), text, or empty."""
    own = [cell.strip() for cell in cells if not _is_missing(cell)]
    if not own:
        return "empty"
    kinds = {"number": sum(map(_is_number, own)), "clock": sum(bool(_CLOCK.fullmatch(cell)) for cell in own)}
    kind = max(kinds, key=lambda kind: kinds[kind])
    return kind if 2 * kinds[kind] >= len(own) else "text"


def _holds_values(row: list[str], kinds: list[str]) -> bool:
    """Return whether a row is one of the table: all columns of numbers or times hold some, or nothing."""
    own = [cell for cell, kind in zip(row, kinds, strict=False) if kind in ("number", "clock")]
    return (
        len(row) >= len(kinds) and _holds_any(row, kinds) and all(_is_value(c) or _is_missing(c) for c in own)
    )


def _holds_any(row: list[str], kinds: list[str]) -> bool:
    return any(_is_value(c) for c, kind in zip(row, kinds, strict=False) if kind in ("number", "clock"))


def _is_missing(cell: str) -> bool:
    return cell.strip().lower() in _MISSING


def _is_value(cell: str) -> bool:
    return _is_number(cell) or bool(_CLOCK.fullmatch(cell.strip()))


def _is_number(cell: str) -> bool:
    cell = cell.strip()
    try:
        return float(cell) == float(cell)  # nan is none
    except ValueError:
        return _NUMBER.fullmatch(cell) is not None


def _decimal_mark(cells: list[str]) -> str | None:
    """Return the mark of decimals in a column's cells; None where they do not tell."""
    for cell in cells:
        at = {mark: cell.rfind(mark) for mark in ".,"}
        if min(at.values()) >= 0:
            return max(at, key=lambda mark: at[mark])
        for mark, other in (".,", ",."):
            if cell.count(mark) > 1:
                return other
            if at[mark] >= 0 and _is_number(cell) and not _THOUSANDS[mark].fullmatch(cell):
                return mark
    return None


def _numbers(path: Path, body: list[tuple[int, list[str]]], cells: list[str], mark: str | None) -> np.ndarray:
    """Return a column's numbers; mark: of decimals; None if the table does not determine it."""
    mark = mark or ("," if any("," in cell for cell in cells) else ".")
    other = ".,".replace(mark, "")
    for k, cell in enumerate(cells):
        if (
            other in cell
            and _is_number(cell)
            and not _THOUSANDS[other].fullmatch(cell.rpartition(mark)[0] or cell)
        ):
            raise AnalyseError(
                f"{path}, row {body[k][0]}: {cell!r}, while decimals of its column begin with {mark!r}"
            )
    others = str.maketrans(dict.fromkeys(other + _GROUPS, ""))

    def plain(cell: str) -> str:
        return cell.translate(others).replace(mark, ".").upper().replace("D", "E")

    def number(cell: str) -> float:
        if not (_is_missing(cell) or _is_number(cell)):
            raise ValueError(cell)
        return float("nan") if _is_missing(cell) else float(plain(cell))

    try:
        return np.array(cells if mark == "." else [plain(cell) for cell in cells], float)
    except ValueError:
        return _each(path, body, cells, number, "number")


def _each(
    path: Path, body: list[tuple[int, list[str]]], cells: list[str], read: Callable[[str], float], what: str
) -> np.ndarray:
    out = np.empty(len(cells))
    for k, cell in enumerate(cells):
        try:
            out[k] = read(cell)
        except ValueError:
            raise AnalyseError(f"{path}, row {body[k][0]}: {cell!r} is no {what}") from None
    return out


def _seconds_of_day(path: Path, body: list[tuple[int, list[str]]], cells: list[str]) -> np.ndarray:
    """Return seconds since the first time of day, whatever the date's order; beyond midnight they go on."""
    has_hours = False

    def seconds(cell: str) -> float:
        nonlocal has_hours
        if _is_missing(cell):
            return float("nan")
        found = _CLOCK.fullmatch(cell)
        if found is None:
            raise ValueError(cell)
        hour, minute, second, half = found.groups()
        has_hours = has_hours or hour is not None
        hours = int(hour or 0) % 12 + 12 * (half[0].lower() == "p") if half else int(hour or 0)
        return 3600.0 * hours + 60 * int(minute) + float(re.sub("[,:]", ".", second))

    times = _each(path, body, cells, seconds, "time of day")
    whole = 86400.0 if has_hours else 3600.0
    steps = np.diff(times)
    back = np.where(np.nan_to_num(steps) < -whole / 2, whole, 0)
    return np.round(times + np.concatenate([[0], np.cumsum(back)]) - times[0], 9)


def _text(path: Path) -> str:
    data = path.read_bytes()
    encodings = ("utf-16",) if data.startswith((b"\xff\xfe", b"\xfe\xff")) else _ENCODINGS
    if b"\0" in data and encodings == _ENCODINGS:
        raise AnalyseError(f"{path} is not a CSV file: it holds null bytes")
    for encoding in encodings:
        try:
            return data.decode(encoding)
        except UnicodeDecodeError as error:
            last = error
    raise AnalyseError(f"{path} is not a CSV file: {last}") from None


def timed(
    path: Path, head: Sequence[tuple[str, str]], table: np.ndarray
) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Return the times in seconds and the values, where they are known, of the columns that hold values.

    head: names and units. A column belongs to the last column of times before it, as where each channel has its own
    clock; else to the first. Raises AnalyseError where there are no times.
    """
    clocks = _clocks(path, head, table)
    out, sparse = dict[int, tuple[np.ndarray, np.ndarray]](), list[str]()
    for k, (name, _) in enumerate(head):
        if k in clocks or _is_index(name, table[:, k]):
            continue
        times, values = clocks[max((at for at in clocks if at < k), default=min(clocks))], table[:, k]
        known = np.isfinite(values) & np.isfinite(times)
        if known.sum() < FEWEST <= len(known):
            sparse += [f"{name} ({known.sum()})"] if name else []
            continue
        out[k] = times[known], values[known]
    if sparse:
        _LOG.warning(f"{path}: columns with fewer than {FEWEST} values are left out: {', '.join(sparse)}")
    return out


def _clocks(path: Path, head: Sequence[tuple[str, str]], table: np.ndarray) -> dict[int, np.ndarray]:
    """Return the columns of times, in seconds, from the first if they count from 1970."""
    named = [k for k, (name, _) in enumerate(head) if _is_name(name)]
    named = named or [k for k, (_, unit) in enumerate(head) if unit in TIME_UNITS and _rises(table[:, k])]
    if not named and not any(name for name, _ in head):
        named = [
            k for k in range(len(head)) if np.isfinite(table[:, k]).all() and not _is_index("", table[:, k])
        ][:1]
        if not named or not _rises(table[:, named[0]]) or not is_filled(table[:, named[0]]):
            raise AnalyseError(
                f"{path} has neither a header nor times in its first column: name a column time_s"
            )
        _LOG.warning(
            f"{path}: has no header; its first column, which rises evenly, is taken as times in seconds"
        )
    if not named:
        columns = ", ".join(f"{name} [{unit}]" if unit else name for name, unit in head)
        raise AnalyseError(f"{path} has no column of times (time_s); its columns: {columns}")
    return {k: _seconds(path, *head[k], table[:, k]) for k in named}


def _seconds(path: Path, name: str, unit: str, times: np.ndarray) -> np.ndarray:
    size = float(np.nanmedian(times))
    since_1970 = [
        factor for factor in (1.0, 1e-3, 1e-6, 1e-9) if _SINCE_1970[0] < size * factor < _SINCE_1970[1]
    ]
    if unit and unit not in TIME_UNITS:
        raise AnalyseError(f"{path}: its times, {name}, are in {unit!r}; expected s, ms, us, ns, min or h")
    factor = TIME_UNITS[unit] if unit else since_1970[0] if since_1970 else 1.0
    if not unit and since_1970 and factor != 1:
        _LOG.warning(f"{path}: its times, {name}, have no unit; they are taken as {factor:g} s since 1970")
    return (times - times[0] if since_1970 else times) * factor


def _is_name(name: str) -> bool:
    return name.lower().replace("_", " ").strip("0123456789 ") in _NAMES


def _rises(values: np.ndarray) -> bool:
    return len(values) > 1 and bool((np.diff(values) >= 0).all() and values[-1] > values[0])


def _is_index(name: str, values: np.ndarray) -> bool:
    """Return whether a column numbers the rows."""
    return name.lower() in _INDICES and len(values) > 1 and bool((np.diff(values) == 1).all())
