"""The data of a PLY: the rows of an element, a block at a time; binary of both byte orders, and ASCII."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterator, Sequence
from typing import BinaryIO

import numpy as np

from ..errors import SplatFileError
from .header import ASCII, Element, Header

ROWS_AT_ONCE = 8192  # keeps the block being taken apart in the processor's cache


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
                f"{element.name} {start} to {last}: expected {width} numbers in each of these lines"
            )
        yield numbers.view(element.dtype(ASCII))
