"""Waveforms in universal files: datasets 58 and 58b, units of dataset 164."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tg4mm.show.analyse.tables import MOST_BYTES, AnalyseError

_MARK = re.compile(rb"(?m)^ {4}-1[ \t]*\r?$\n?")
_END = re.compile(rb"\r?\n? {4}-1[ \t]*\r?\n?")  # after binary numbers
_HEAD = 11  # lines of dataset 58 before its numbers
_ORDERS = {"1": "<", "2": ">"}  # of bytes, in numpy's marks
_TIME = 17  # the abscissa's specific data type
_SINGLE, _DOUBLE = 2, 4  # data types
_WIDTHS = {
    (_SINGLE, True): (13,),
    (_SINGLE, False): (13, 13),
    (_DOUBLE, True): (20,),
    (_DOUBLE, False): (13, 20),
}
_DEVIATION = "standard deviation"  # what tg4mm writes of a waveform beside it


def is_universal(path: Path) -> bool:
    """Return whether a file begins as universal files do."""
    with path.open("rb") as file:
        return _MARK.match(file.read(1 << 8).lstrip(b"\r\n")) is not None


@dataclass(frozen=True)
class TimeFunction:
    """One function of time."""

    name: str
    kind: int  # specific data type: 8 displacement, 9 force, 11 velocity, 12 acceleration
    unit: str  # as it is labelled
    metres: float  # per unit of length, where the file says so
    times_s: np.ndarray  # [T]
    values: np.ndarray  # [T]
    is_deviation: bool


def waveforms(path: Path) -> list[TimeFunction]:
    """Return all functions of time. Raises AnalyseError if there are none, and for a damaged file."""
    if path.stat().st_size > MOST_BYTES:
        raise AnalyseError(f"{path} is larger than {MOST_BYTES >> 30} GiB")
    found, metres = list[TimeFunction](), 1.0
    try:
        for number, lines, content in _sets(path.read_bytes()):
            if number == "164":
                metres = 1 / float(lines[1][:25].replace("D", "E"))
            elif number.startswith("58") and (one := _waveform(number, lines, content, metres)) is not None:
                found.append(one)
    except (IndexError, OverflowError, ValueError, ZeroDivisionError) as error:
        raise AnalyseError(f"{path} is not a readable universal file: {error}") from None
    if not found:
        raise AnalyseError(f"{path} holds no waveform: no real function of time in a dataset 58")
    return found


def _sets(data: bytes) -> Iterator[tuple[str, list[str], bytes]]:
    """Yield number, head lines and content of each dataset."""
    at = 0
    while (mark := _MARK.search(data, at)) is not None:
        first, _, rest = data[mark.end() : mark.end() + (1 << 12)].partition(b"\n")
        begin, words = mark.end() + len(first) + 1, first.decode("latin-1").split()
        number = words[0] if words else ""
        ends = [m.end() for m in re.finditer(rb"\n", rest)][:_HEAD]
        start = begin + (ends[-1] if len(ends) == _HEAD and number.startswith("58") else 0)
        if number == "58b":
            if words[1] not in _ORDERS or words[2] != "2":
                raise ValueError(f"its numbers are of the kind {words[1:3]}; expected IEEE 754 ([1 or 2, 2])")
            number += _ORDERS[words[1]]
            stop = start + int(words[4])
            end = _END.match(data, stop)
        elif number == "-1":  # an end without a beginning, as some writers leave
            at = mark.end()
            continue
        else:
            end = _MARK.search(data, begin)
            stop = end.start() if end else len(data)
        if end is None or stop > len(data):
            raise ValueError("it is cut off")
        head = data[begin : start if number.startswith("58") else stop].decode("latin-1").splitlines()
        yield number, head, data[start:stop]
        at = end.end()


def _waveform(number: str, lines: list[str], content: bytes, metres: float) -> TimeFunction | None:
    data_type, count, spacing = (int(lines[6][k : k + 10]) for k in (0, 10, 20))
    start, step = (float(lines[6][k : k + 13]) for k in (30, 43))
    if int(lines[7][:10]) != _TIME or data_type not in (_SINGLE, _DOUBLE):
        return None
    is_even = spacing == 1
    if number.startswith("58b"):
        if not is_even and data_type == _DOUBLE:
            raise ValueError(
                "binary functions with uneven spacing in double precision cannot be read; write them with even spacing "
                "or in single precision"
            )
        numbers = np.frombuffer(content, number[-1] + ("f4" if data_type == _SINGLE else "f8")).astype(float)
    else:
        numbers = np.array(list(_numbers(content.decode("latin-1"), _WIDTHS[data_type, is_even])))
    if len(numbers) != count * (1 if is_even else 2) or not np.isfinite(numbers).all():
        raise ValueError(f"a function has {len(numbers)} numbers that are finite; expected {count} samples")
    times = start + step * np.arange(count) if is_even else numbers[0::2]
    values = numbers if is_even else numbers[1::2]
    node, direction = lines[5][41:51].strip(), int(lines[5][51:55] or 0)
    axis = {1: "x", 2: "y", 3: "z"}.get(abs(direction), str(direction))
    named = lines[0].split(",")[0].strip()
    name = f"{named if named not in ('', 'NONE') else node}/{'-' * (direction < 0)}{axis}"
    kind, unit = int(lines[8][:10]), lines[8][47:67].strip()
    return TimeFunction(name, kind, unit, metres, times, values, _DEVIATION in lines[1])


def _numbers(text: str, widths: tuple[int, ...]) -> Iterator[float]:
    """Yield the numbers of lines with columns of alternating widths."""
    for line in text.splitlines():
        at, k = 0, 0
        while line[at:].strip():
            width = widths[k % len(widths)]
            yield float(line[at : at + width].replace("D", "E"))
            at, k = at + width, k + 1
