"""Options within their limits."""

from __future__ import annotations

from collections.abc import Collection

from tg4mm.core.values import Number

from .errors import GenerateError


def check_choice(option: str, value: str, choices: Collection[str]) -> None:
    """Raises GenerateError unless the value is one of the choices."""
    if value not in choices:
        raise GenerateError(f"{option} {value!r} is none of {', '.join(choices)}")


def check_whole(option: str, value: object, low: int, high: int) -> None:
    """Raises GenerateError unless the value is a whole number in low … high."""
    if not Number(low, high, whole=True).fits(value):
        raise GenerateError(f"{option} {value!r} is not a whole number in {low} … {high}")


def check_within(option: str, value: float, low: float, high: float, unit: str, above: bool = False) -> None:
    """Raises GenerateError unless the value is in low … high, where `above` leaves low out."""
    if not Number(low, high, above=above).fits(value):
        raise GenerateError(f"{option} {value!r} is not in {low:g} … {high:g} {unit}")
