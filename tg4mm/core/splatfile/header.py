"""The header of a PLY, everything checked before any data is read; and its rows, a block at a time."""

import itertools
import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, BinaryIO

import numpy as np

from tg4mm.core.errors import SplatFileError
from tg4mm.core.splatfile import model
from tg4mm.core.untrusted import parse_json
from tg4mm.core.values import Number

MAX_HEADER_BYTES = 1 << 20
ASCII, BIG_ENDIAN = "ascii", "binary_big_endian"
FORMS = ("binary_little_endian", BIG_ENDIAN, ASCII)
TYPES = {
    **dict.fromkeys(("char", "int8"), "<i1"),
    **dict.fromkeys(("uchar", "uint8"), "<u1"),
    **dict.fromkeys(("short", "int16"), "<i2"),
    **dict.fromkeys(("ushort", "uint16"), "<u2"),
    **dict.fromkeys(("int", "int32"), "<i4"),
    **dict.fromkeys(("uint", "uint32"), "<u4"),
    **dict.fromkeys(("float", "float32"), "<f4"),
    **dict.fromkeys(("double", "float64"), "<f8"),
}

# What Brush and others write of files that are drawn with compensated opacities.
_ANTIALIASED = re.compile(r"(?i)\b(mip\b|anti-?alias)")
ROWS_AT_ONCE = 8192  # keeps the block being taken apart in the processor's cache


@dataclass(frozen=True)
class Element:
    """One `element` line and the `property` lines below it."""

    name: str
    count: int
    properties: dict[str, str] = field(default_factory=dict)  # name → numpy type, "list" for a list

    @property
    def lists(self) -> list[str]:
        """The properties that are lists, which no splat file has."""
        return [name for name, kind in self.properties.items() if kind == "list"]

    def dtype(self, form: str) -> np.dtype:
        """One record, packed; of ASCII, numbers as they are parsed."""
        if form == ASCII:
            return np.dtype([(name, "<f8") for name in self.properties])
        return np.dtype(list(self.properties.items())).newbyteorder(">" if form == BIG_ENDIAN else "<")

    def nbytes(self, form: str) -> int:
        """Size of the element's data, without lists; of ASCII the least there can be, a digit and a space a number."""
        size = 2 * len(self.properties) if form == ASCII else self.dtype(form).itemsize
        return self.count * size if self.properties else 0


@dataclass(frozen=True)
class Header:
    """A whole header. Messages carry no file name; the reader puts it in front."""

    form: str  # of FORMS
    elements: tuple[Element, ...]
    about: dict[str, Any] | None  # what `comment tg4mm` says; None for a plain 3DGS PLY
    nbytes: int  # length of the header itself
    is_antialiased: bool = False  # as a comment says


def read_header(file: BinaryIO) -> Header:
    """Parse the header at the start of `file`; SplatFileError if it is not one this reader can follow."""
    lines, form, nbytes = _lines(file)
    elements: list[Element] = []
    about = None
    for line in lines:
        words = line.split()
        if line.startswith(model.MARK):
            if about is not None:
                raise SplatFileError("header has two 'comment tg4mm' lines")
            about = _about(line[len(model.MARK) :])
        elif not words or words[0] in ("comment", "obj_info", "format"):
            continue
        elif words[0] == "element" and len(words) == 3:
            elements.append(Element(words[1], _count(line)))
        elif words[0] == "property" and elements and len(words) >= 3:
            _add_property(elements[-1], words, line)
        else:
            raise SplatFileError(f"header line {line[:60]!r} is not understood")
    is_antialiased = any(_ANTIALIASED.search(line) for line in lines if line.startswith("comment"))
    return Header(form, tuple(elements), about, nbytes, is_antialiased)


def _lines(file: BinaryIO) -> tuple[list[str], str, int]:
    """The lines between the first and end_header, the form of the data, and the header's length."""
    if file.readline(8).rstrip() != b"ply":
        raise SplatFileError("is not a PLY: its first line is not 'ply'")
    lines: list[str] = []
    while True:
        raw = file.readline(MAX_HEADER_BYTES)
        if not raw.endswith(b"\n") or file.tell() > MAX_HEADER_BYTES:
            raise SplatFileError(f"header has no end_header line in the first {file.tell()} bytes")
        line = raw.decode("latin-1").strip()
        if line == "end_header":
            break
        lines.append(line)
    formats = [line for line in lines if line.startswith("format ")]
    known = {f"format {form} 1.0": form for form in FORMS}
    if len(formats) != 1 or formats[0] not in known:
        raise SplatFileError(
            f"has {' and '.join(formats)[:80] or 'no format line'}; expected format {', '.join(FORMS)} 1.0"
        )
    return lines, known[formats[0]], file.tell()


def _count(line: str) -> int:
    text = line.split()[2]
    if not (text.isascii() and text.isdigit() and len(text) < 19):
        raise SplatFileError(f"header line {line[:60]!r} has no usable count")
    return int(text)


def _add_property(element: Element, words: list[str], line: str) -> None:
    name, kind = words[-1], "list" if words[1] == "list" else TYPES.get(words[1])
    if kind is None or (kind != "list" and len(words) != 3):
        raise SplatFileError(f"header line {line[:60]!r} has no type known to PLY")
    if name in element.properties:
        raise SplatFileError(f"property {name} appears twice")
    element.properties[name] = kind


def _about(text: str) -> dict[str, Any]:
    try:
        about = parse_json(text)
    except ValueError as error:
        raise SplatFileError(f"'comment tg4mm' is not valid JSON: {error}") from error
    if not isinstance(about, dict):
        raise SplatFileError(f"'comment tg4mm' holds {text[:60]}; expected an object {{…}}")
    version = about.get("format_version")
    if version != model.FORMAT_VERSION or isinstance(version, bool):
        raise SplatFileError(f"format_version is {version!r}; this reader knows {model.FORMAT_VERSION}")
    frequencies = about.get("frequencies_hz")
    if not isinstance(frequencies, list) or not all(Number().fits(f) for f in frequencies):
        raise SplatFileError(f"frequencies_hz is {str(frequencies)[:60]}; expected a list of finite numbers")
    for key in ("fps", "unit_scale_m", "time_origin_s", "n_timesteps", "low_pass_px2"):
        if about.get(key) is not None and not Number().fits(about[key]):
            raise SplatFileError(f"{key} is {str(about[key])[:60]}; expected a finite number")
    if about.get("n_timesteps") is not None and about["n_timesteps"] != int(about["n_timesteps"]):
        raise SplatFileError(f"n_timesteps is {about['n_timesteps']}; expected a whole number")
    return about


def check_size(header: Header, actual: int) -> None:
    """Raises SplatFileError if a file of `actual` bytes cannot be what its header says; no memory is given yet."""
    for element in header.elements:
        if element.lists and element.count:
            raise SplatFileError(
                f"element {element.name} has a list property, {element.lists[0]}; splat files have none"
            )
    expected = header.nbytes + sum(
        element.nbytes(header.form) for element in header.elements if element.count
    )
    if actual == expected or (header.form == ASCII and actual + 1 >= expected):
        return
    problem = "truncated" if actual < expected else "too long"
    counts = ", ".join(f"{e.count} {'vertices' if e.name == 'vertex' else e.name}" for e in header.elements)
    least = " or more" if header.form == ASCII else ""
    raise SplatFileError(f"is {problem}: {actual} bytes, expected {expected}{least} for {counts}")


def blocks(file: BinaryIO, header: Header, element: Element) -> Iterator[np.ndarray]:
    """The rows of `element` as arrays of records, at most ROWS_AT_ONCE each.

    The file has passed `check_size`. Raises SplatFileError for text that is no number, or too little or too much of it.
    """
    before = header.elements[: header.elements.index(element)]
    if header.form == ASCII:
        file.seek(header.nbytes)
        lines = (line for line in file if not line.isspace())
        for _ in itertools.islice(lines, sum(e.count for e in before if e.properties)):
            pass
        yield from _parsed(lines, element)
        after = header.elements[len(before) + 1 :]
        left = sum(1 for _ in lines) - sum(e.count for e in after if e.properties)
        if left:
            raise SplatFileError(f"is {'truncated' if left < 0 else 'too long'}: {abs(left)} lines of it")
        return
    file.seek(header.nbytes + sum(e.nbytes(header.form) for e in before if e.count))
    for start in range(0, element.count, ROWS_AT_ONCE):
        rows = min(ROWS_AT_ONCE, element.count - start)
        block = np.fromfile(file, element.dtype(header.form), rows)
        if len(block) != rows:
            raise SplatFileError(f"is truncated: {start + len(block)} vertices, expected {element.count}")
        yield block


def columns(block: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """[rows, len(names)] of a block; a view where they lie side by side and all are of one type."""
    fields, kinds = block.dtype.names or (), {block.dtype[i] for i in range(len(block.dtype))}
    if len(kinds) == 1:
        table, at = block.view(kinds.pop()).reshape(len(block), -1), [fields.index(name) for name in names]
        side_by_side = at == list(range(at[0], at[0] + len(at))) if at else False
        return table[:, at[0] : at[0] + len(at)] if side_by_side else table[:, at]
    out = np.empty((len(block), len(names)))
    for i, name in enumerate(names):
        out[:, i] = block[name]
    return out


def _parsed(lines: Iterator[bytes], element: Element) -> Iterator[np.ndarray]:
    width = len(element.properties)
    for start in range(0, element.count, ROWS_AT_ONCE):
        rows = min(ROWS_AT_ONCE, element.count - start)
        text = list(itertools.islice(lines, rows))
        if len(text) != rows:
            raise SplatFileError(
                f"is truncated: {start + len(text)} lines of {element.name}, of {element.count}"
            )
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", DeprecationWarning)  # numpy's word for text that is no number
                numbers = np.fromstring(b" ".join(text).decode("latin-1"), np.float64, sep=" ")
        except (DeprecationWarning, ValueError):
            numbers = np.empty(0)
        if len(numbers) != rows * width:
            last = start + rows - 1
            raise SplatFileError(
                f"rows {start} to {last} of element {element.name}: expected {width} numbers in each row"
            )
        yield numbers.view(element.dtype(ASCII))
