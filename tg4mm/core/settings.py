"""Settings of a stage that say what they mean: listed by `tg4mm train --list-settings`, looked up by `--set`."""

import dataclasses
import difflib
from collections.abc import Mapping
from typing import Any

from tg4mm.core.digits import aligned
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.values import require


def setting(default: Any, about: str, unit: str = "") -> Any:
    """A field of a settings' dataclass: its default, what it means, and its unit, "" for a plain number."""
    return dataclasses.field(default=default, metadata={"about": about, "unit": unit})


def of_file(kind: type, values: Any, where: str, error: type[Tg4mmError]) -> Any:
    """Build a settings dataclass from the values that a file holds.

    Raises `error` for an unknown name, as from another version, and for a value of the wrong type.
    """
    require(where, values, dict, error)
    fields = {field.name: type(field.default) for field in dataclasses.fields(kind)}
    for name, value in values.items():
        if name not in fields:
            raise error(f"{where}.{name} is a setting that this version of tg4mm does not have")
        require(f"{where}.{name}", value, fields[name], error)
    return kind(**values)


def listed(defaults: Mapping[str, Any]) -> list[str]:
    """A line for each setting of `{stage: configuration}`: name, default with unit, meaning."""
    rows = []
    for stage, config in defaults.items():
        for field in dataclasses.fields(config):
            value = getattr(config, field.name)
            text = str(value).lower() if isinstance(value, bool) else str(value) or "empty"
            unit = field.metadata.get("unit", "") if value != "" else ""
            rows.append((f"{stage}.{field.name}", f"{text} {unit}".strip(), field.metadata.get("about", "")))
    return aligned(rows)


def unknown(name: str, defaults: Mapping[str, Any]) -> Tg4mmError:
    """The error for a name that no setting has, with those that may be meant."""
    known = [
        f"{stage}.{field.name}" for stage, config in defaults.items() for field in dataclasses.fields(config)
    ]
    stage, _, key = name.rpartition(".")
    keys = dict.fromkeys(one.rpartition(".")[2] for one in known)
    close = [key] if key in keys else difflib.get_close_matches(key, keys, n=1, cutoff=0.7)
    meant = [one for one in known if one.rpartition(".")[2] in close]
    meant = [one for one in meant if one.startswith(f"{stage}.")] or meant
    question = f"did you mean {' or '.join(meant)}? " if meant else ""
    return Tg4mmError(
        f"setting {name!r} is unknown; {question}tg4mm train --list-settings lists all, with meaning, default and unit"
    )
