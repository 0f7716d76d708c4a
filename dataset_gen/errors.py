"""The generator's own error, and options within their limits."""

import sys
from collections.abc import Collection

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.extras import install
from tg4mm.core.values import Number


class GenerateError(Tg4mmError):
    """A dataset that cannot be generated as asked. One line, with the option or file and its value."""


def blender_remedy() -> str:
    """Return how to install Blender's Python module, which exists for two Python versions only."""
    have = sys.version_info[:2]
    if have in ((3, 11), (3, 13)):
        return install("generate")
    version = ".".join(map(str, have))
    return (
        f"this is Python {version}, and Blender's module comes for 3.11 (Blender 4.5) and 3.13 (5.3) alone: make an "
        "environment with one of these"
    )


def check_choice(option: str, value: str, choices: Collection[str]) -> None:
    """Raises GenerateError unless the value is one of the choices."""
    if value not in choices:
        raise GenerateError(f"{option} {value!r} is not one of {', '.join(choices)}")


def check_whole(option: str, value: object, low: int, high: int) -> None:
    """Raises GenerateError unless the value is a whole number in low … high."""
    if not Number(low, high, whole=True).fits(value):
        raise GenerateError(f"{option} {value!r} is not a whole number in {low} … {high}")


def check_within(option: str, value: float, low: float, high: float, unit: str, above: bool = False) -> None:
    """Raises GenerateError unless the value is in low … high, where `above` leaves low out."""
    if not Number(low, high, above=above).fits(value):
        raise GenerateError(f"{option} {value!r} is not in {low:g} … {high:g} {unit}")
