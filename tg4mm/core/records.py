"""JSON objects in files, read back: values checked where they are read, so that an error names file, key and value.

What tg4mm wrote may carry a digest of its other entries (`write_sealed`); it then is what was written, or is refused.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tg4mm.core.errors import CaptureError
from tg4mm.core.files import json_digest, write_json
from tg4mm.core.untrusted import read_json
from tg4mm.core.values import Number, check_form, shown

DIGEST = "digest"


def write_sealed(path: Path, values: Mapping[str, Any]) -> None:
    """Write an object of JSON values with a digest of it, atomically."""
    write_json(path, {**values, DIGEST: json_digest(dict(values))})


def read_formed(path: Path, form: Mapping[Any, Any]) -> dict[str, Any]:
    """A JSON file of that form (`values`), without its digest.

    Raises ValueError of one line, without the file's name, for what is no JSON, not what was written, or of another
    form; and OSError.
    """
    values = read_json(path, finite=True)
    digest = values.pop(DIGEST, None) if isinstance(values, dict) else None
    if digest is not None and digest != json_digest(values):
        raise ValueError("is damaged or edited: its content is not what was written")
    check_form(values, form)
    return dict(values)


def as_number(value: Any) -> float:
    """A JSON number as float, NaN for anything else (booleans and numbers past float's range too)."""
    return float(value) if Number().fits(value) else math.nan


@dataclass(frozen=True)
class Record:
    """A JSON object and where it came from; its getters raise CaptureError with both."""

    where: str  # file, and the part of it
    values: dict[str, Any]

    def error(self, key: str, expected: str) -> CaptureError:
        """CaptureError saying what `key` is and what it should be."""
        if key not in self.values:
            return CaptureError(f"{self.where}: {key} is missing; expected {expected}")
        return CaptureError(f"{self.where}: {key} is {shown(self.values[key])}; expected {expected}")

    def has(self, key: str) -> bool:
        """Return whether `key` exists with a value other than null."""
        return self.values.get(key) is not None

    def number(self, key: str, low: float = -math.inf, high: float = math.inf) -> float:
        """A finite number with low < number < high."""
        rule = Number(low, high, above=True, below=True)
        if not rule.fits(self.values.get(key)):
            raise self.error(key, str(rule))
        return float(self.values[key])

    def whole(self, key: str, at_least: int) -> int:
        """A whole number of at least `at_least` (30.0 counts as whole)."""
        value = as_number(self.values.get(key))
        if not (value.is_integer() and value >= at_least):
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
