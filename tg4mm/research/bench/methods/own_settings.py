"""Settings of a method that is compared only: `--set NAME.KEY=VALUE`, the fields of its frozen dataclass of numbers."""

import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar

from tg4mm.core.errors import Tg4mmError

_MAY_BE_ZERO = ("smoothness", "seed", "margin", "stiffness")


C = TypeVar("C")


def configured(name: str, usual: C, given: Mapping[str, str]) -> C:
    """`usual` with the settings `NAME.KEY`. Raises Tg4mmError for one that is none, and a value that does not fit."""
    names = [f"{name}.{f.name}" for f in dataclasses.fields(usual)]  # type: ignore[arg-type]
    for key in given:
        if key not in names:
            raise Tg4mmError(f"--set {key}: {name} has {', '.join(names)}")
    values = {k.partition(".")[2]: _number(k, v, usual) for k, v in given.items()}
    return dataclasses.replace(usual, **values)  # type: ignore[type-var]


def overrides(name: str, config: Any, usual: Any) -> dict[str, str]:
    """The settings that differ from the usual ones, as `--set` takes them."""
    before = dataclasses.asdict(usual)
    return {f"{name}.{k}": str(v) for k, v in dataclasses.asdict(config).items() if v != before[k]}


def _number(name: str, text: str, usual: Any) -> Any:
    kind = type(getattr(usual, name.partition(".")[2]))
    try:
        value = kind(text)
    except ValueError:
        value = -1
    least = 0 if name.endswith(_MAY_BE_ZERO) else 1 if kind is int else 1e-12
    if not least <= value < 1e9:
        raise Tg4mmError(f"setting {name} is {text!r}, expected {kind.__name__} of at least {least:g}")
    return value
