"""The header of a PLY: elements, properties, the tg4mm line; everything checked before any data is read."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, BinaryIO

import numpy as np

from ..errors import SplatFileError
from ..untrusted import parse_json
from ..values import Number
from . import layout

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


def read_header(file: BinaryIO) -> Header:
    """Parse the header at the start of `file`; SplatFileError if it is not one this reader can follow."""
    lines, form, nbytes = _lines(file)
    elements: list[Element] = []
    about = None
    for line in lines:
        words = line.split()
        if line.startswith(layout.MARK):
            if about is not None:
                raise SplatFileError("header has two 'comment tg4mm' lines")
            about = _about(line[len(layout.MARK) :])
        elif not words or words[0] in ("comment", "obj_info", "format"):
            continue
        elif words[0] == "element" and len(words) == 3:
            elements.append(Element(words[1], _count(line)))
        elif words[0] == "property" and elements and len(words) >= 3:
            _add_property(elements[-1], words, line)
        else:
            raise SplatFileError(f"header line {line[:60]!r} is not understood")
    return Header(form, tuple(elements), about, nbytes)


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
    if version != layout.FORMAT_VERSION or isinstance(version, bool):
        raise SplatFileError(f"format_version is {version!r}; this reader knows {layout.FORMAT_VERSION}")
    frequencies = about.get("frequencies_hz")
    if not isinstance(frequencies, list) or not all(Number().fits(f) for f in frequencies):
        raise SplatFileError(f"frequencies_hz is {str(frequencies)[:60]}; expected a list of finite numbers")
    for key in ("fps", "unit_scale_m", "time_origin_s", "n_timesteps", "low_pass_px2"):
        if about.get(key) is not None and not Number().fits(about[key]):
            raise SplatFileError(f"{key} is {str(about[key])[:60]}; expected a finite number")
    if about.get("n_timesteps") is not None and about["n_timesteps"] != int(about["n_timesteps"]):
        raise SplatFileError(f"n_timesteps is {about['n_timesteps']}; expected a whole number")
    return about
