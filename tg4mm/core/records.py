"""JSON objects whose values are checked where they are read, so that an error names file, key and value."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tg4mm.core.errors import CaptureError
from tg4mm.core.untrusted import read_json


def shown(value: Any, limit: int = 60) -> str:
    """The value as one short line for a message."""
    text = repr(value)
    return text if len(text) <= limit else text[: limit - 1] + "…"


def as_number(value: Any) -> float:
    """A JSON number as float, NaN for anything else (booleans and numbers past float's range too)."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return math.nan
    try:
        return float(value)
    except OverflowError:
        return math.nan


@dataclass(frozen=True)
class Record:
    """A JSON object and where it came from; its getters raise CaptureError with both."""

    where: str  # file, and the place in it
    values: dict[str, Any]

    def error(self, key: str, expected: str) -> CaptureError:
        """CaptureError saying what `key` is and what it should be."""
        if key not in self.values:
            return CaptureError(f"{self.where}: {key} is missing; expected {expected}")
        return CaptureError(f"{self.where}: {key} is {shown(self.values[key])}; expected {expected}")

    def has(self, key: str) -> bool:
        """Whether `key` is there with a value other than null."""
        return self.values.get(key) is not None

    def number(self, key: str, low: float = -math.inf, high: float = math.inf) -> float:
        """A finite number with low < number < high."""
        value = as_number(self.values.get(key))
        if not (math.isfinite(value) and low < value < high):
            bounds = [f"above {low:g}"] * (low > -math.inf) + [f"below {high:g}"] * (high < math.inf)
            raise self.error(key, " ".join(["a finite number", " and ".join(bounds)]).strip())
        return value

    def whole(self, key: str, at_least: int) -> int:
        """A whole number of at least `at_least` (30.0 counts as whole)."""
        value = as_number(self.values.get(key))
        if not (math.isfinite(value) and value.is_integer() and value >= at_least):
            raise self.error(key, f"a whole number of at least {at_least}")
        return int(value)

    def text(self, key: str) -> str:
        """A string that is not empty."""
        value = self.values.get(key)
        if not isinstance(value, str) or not value:
            raise self.error(key, "a non-empty string")
        return value


def read_record(path: Path) -> Record:
    """A JSON file whose top level is an object."""
    try:
        values = read_json(path)
    except OSError as error:
        raise CaptureError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise CaptureError(f"{path}: is not valid JSON: {error}") from error
    if not isinstance(values, dict):
        raise CaptureError(f"{path}: holds {shown(values)}; expected a JSON object {{…}}")
    return Record(str(path), values)
