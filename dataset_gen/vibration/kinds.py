"""The kinds of displacement fields by name, and how a field is read from and written to plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, asdict, fields
from typing import Any, get_args, get_type_hints

from .beams import Bending
from .fields import Drift, Field, Group, Jiggle, Rock, Translate, Twist
from .plates import Membrane, Plate
from .waves import Wave

KINDS: dict[str, type[Any]] = {
    cls.kind: cls for cls in (Translate, Rock, Twist, Bending, Membrane, Plate, Wave, Jiggle, Group, Drift)
}


def keys(kind: str) -> tuple[str, ...]:
    """Names of the fields of a kind, in order."""
    return tuple(f.name for f in fields(KINDS[kind]))


def read_field(kind: str, data: Mapping[str, Any]) -> Field:
    """A field from the values of its keys; null is the same as absent. Raises ValueError naming the key."""
    cls, values = KINDS[kind], {}
    hints = get_type_hints(cls, include_extras=True)
    for f in fields(cls):
        if data.get(f.name) is None:
            if f.default is MISSING:
                raise ValueError(f"{f.name} is missing: a mode of kind {kind} needs it")
            continue
        read = get_args(hints[f.name])[1]
        try:
            values[f.name] = read(data[f.name])
        except ValueError as error:
            raise ValueError(f"{f.name}: {error}") from None
    field: Field = cls(**values)
    return field


def field_data(field: Field) -> dict[str, Any]:
    """The values of a field's keys as plain data, without those that are absent."""
    return {name: _plain(value) for name, value in asdict(field).items() if value is not None}  # type: ignore[call-overload]


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _plain(v) for name, v in value.items()}
    return list(value) if isinstance(value, tuple) else value
