"""JSON that tg4mm wrote, read back: what each value must be is said once, as a form, before anything computes with it.

A form is one of

    float, int, str, bool    a finite number of at most LARGEST; a whole number of at least 0; text; true or false
    dict, list               an object or a list of anything
    Maybe(form)              what fits the form, or null
    Just(value)              that value
    [form]                   a list of what fits it
    {"a": form, "b?": form}  an object with the key a; b may be absent, and any other key may be there
    {str: form}              an object with any other keys; {float: form}: with numbers as keys, as "20"

A file may carry a digest of its other entries (`write_sealed`); then it is what was written, or it is refused.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tg4mm.core.files import json_digest, write_json
from tg4mm.core.untrusted import read_json

LARGEST = 1e30  # past what any figure is, and far from where sums overflow
DIGEST = "digest"
_NAMES = {
    float: "a finite number",
    int: "a whole number of at least 0",
    str: "text",
    bool: "true or false",
    dict: "an object",
    list: "a list",
}


@dataclass(frozen=True)
class Maybe:
    """What fits a form, or null."""

    form: Any


@dataclass(frozen=True)
class Just:
    """One value."""

    value: Any


def write_sealed(path: Path, values: Mapping[str, Any]) -> None:
    """Write an object of JSON values with a digest of it, atomically."""
    write_json(path, {**values, DIGEST: json_digest(dict(values))})


def read_formed(path: Path, form: Mapping[Any, Any]) -> dict[str, Any]:
    """A JSON file of that form, without its digest.

    Raises ValueError of one line, without the file's name, for what is no JSON, not what was written, or of another
    form; and OSError.
    """
    values = read_json(path, finite=True)
    digest = values.pop(DIGEST, None) if isinstance(values, dict) else None
    if digest is not None and digest != json_digest(values):
        raise ValueError("is damaged or edited: its content is not what was written")
    check_form(values, form)
    return dict(values)


def check_form(value: Any, form: Any, where: str = "") -> None:
    """Raises ValueError naming the first place that does not fit."""
    if isinstance(form, Maybe):
        if value is not None:
            check_form(value, form.form, where)
    elif isinstance(form, Just):
        if type(value) is not type(form.value) or value != form.value:
            raise ValueError(f"{_place(where)}is {_shown(value)}, expected {form.value!r}")
    elif isinstance(form, list):
        _must(isinstance(value, list), value, list, where)
        for i, item in enumerate(value):
            check_form(item, form[0], f"{where}[{i}]")
    elif isinstance(form, Mapping):
        _must(isinstance(value, dict), value, dict, where)
        _check_keys(value, form, where)
    else:
        _must(_is(value, form), value, form, where)


def _check_keys(value: dict[str, Any], form: Mapping[Any, Any], where: str) -> None:
    named = {key.removesuffix("?") for key in form if isinstance(key, str)}
    for key, inner in form.items():
        if isinstance(key, type):
            for name, item in ((n, i) for n, i in value.items() if n not in named):
                if key is float and not _is_numeral(name):
                    raise ValueError(f"{_place(where)}has the key {name[:60]!r}, expected a number")
                check_form(item, inner, f"{where}.{name[:60]}".lstrip("."))
            continue
        name = key.removesuffix("?")
        if name in value:
            check_form(value[name], inner, f"{where}.{name}".lstrip("."))
        elif name == key:
            raise ValueError(f"{_place(where)}has no {name}")


def _is(value: Any, kind: type) -> bool:
    if kind is float:
        return type(value) in (int, float) and abs(value) <= LARGEST  # NaN is not
    if kind is int:
        return type(value) is int and 0 <= value <= LARGEST
    return isinstance(value, kind)


def _is_numeral(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _must(fits: bool, value: Any, kind: type, where: str) -> None:
    if not fits:
        raise ValueError(f"{_place(where)}is {_shown(value)}, expected {_NAMES[kind]}")


def _shown(value: Any) -> str:
    return repr(value)[:60]


def _place(where: str) -> str:
    return f"{where} " if where else ""
