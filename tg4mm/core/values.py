"""Rules for values of files, headers, settings and options, checked before anything computes with them.

A rule is one of

    float, int, str, bool    a finite number of at most LARGEST; a whole number of at least 0; text; true or false
    Number(low, high, …)     a number within bounds
    Choice(a, b, …)          one of these
    Either(rule, rule)       what fits one of two rules
    dict, list               an object or a list of anything
    Maybe(rule)              what fits the rule, or null
    Just(value)              that value
    [rule]                   a list of what fits it
    {"a": rule, "b?": rule}  an object with the key a; b may be absent, and any other key may be there
    {str: rule}              an object with any other keys; {float: rule}: with numbers as keys, as "20"

Needs Python's library alone: Blender's Python reads by it too.
"""

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

LARGEST = 1e30  # past what any figure is, and far from where sums overflow


@dataclass(frozen=True)
class Number:
    """A finite number within bounds that are in, or out (`above`, `below`); true and false are none."""

    low: float = -math.inf
    high: float = math.inf
    above: bool = False
    below: bool = False
    whole: bool = False  # an int, for 1.0 is not written for one

    def fits(self, value: Any) -> bool:
        """Return whether a value of any type is such a number."""
        is_number = isinstance(value, Integral if self.whole else Real)  # numpy's numbers too
        if not is_number or isinstance(value, bool) or not abs(value) <= sys.float_info.max:  # NaN is not
            return False
        low_fits = value > self.low if self.above else value >= self.low
        return bool(low_fits and (value < self.high if self.below else value <= self.high))

    def __str__(self) -> str:
        noun = "a whole number" if self.whole else "a finite number"
        if math.inf > self.high and self.low > -math.inf and not (self.above or self.below):
            return f"{_figure(self.low)} to {_figure(self.high)}"
        bounds = []
        if self.low > -math.inf:
            bounds.append(f"{'above' if self.above else 'of at least'} {self.low:g}")
        if self.high < math.inf:
            bounds.append(f"{'below' if self.below else 'of at most'} {self.high:g}")
        return " ".join([noun, " and ".join(bounds)]).strip()


@dataclass(frozen=True, init=False)
class Choice:
    """One of these texts."""

    values: tuple[str, ...]

    def __init__(self, *values: str) -> None:
        object.__setattr__(self, "values", values)

    def __str__(self) -> str:
        return ", ".join(self.values)


@dataclass(frozen=True)
class Either:
    """A value that fits one of two rules."""

    first: Any
    second: Any

    def __str__(self) -> str:
        return f"{words(self.first)}, or {words(self.second)}"


@dataclass(frozen=True)
class Maybe:
    """A value that fits a rule, or null."""

    rule: Any

    def __str__(self) -> str:
        return words(self.rule)


@dataclass(frozen=True)
class Just:
    """One value."""

    value: Any

    def __str__(self) -> str:
        return repr(self.value)


POSITIVE, NOT_NEGATIVE = Number(0, above=True), Number(0)
SEED = Number(0, 2**63 - 1, whole=True)
_NAMED: dict[Any, tuple[str, Any]] = {
    float: ("a finite number", Number(-LARGEST, LARGEST)),
    int: ("a whole number of at least 0", Number(0, LARGEST, whole=True)),
    str: ("text", str),
    bool: ("true or false", bool),
    dict: ("an object", dict),
    list: ("a list", list),
}


def words(rule: Any) -> str:
    """A rule as the end of a message, after "expected"."""
    if isinstance(rule, list | Mapping):
        rule = list if isinstance(rule, list) else dict
    return _NAMED[rule][0] if isinstance(rule, type) else str(rule)


def shown(value: Any, limit: int = 60) -> str:
    """The value as one short line for a message."""
    text = repr(value)
    return text if len(text) <= limit else text[: limit - 1] + "…"


def fits(value: Any, rule: Any) -> bool:
    """Return whether a value fits a rule other than a list or an object."""
    if isinstance(rule, Maybe):
        return value is None or fits(value, rule.rule)
    if isinstance(rule, Either):
        return fits(value, rule.first) or fits(value, rule.second)
    if isinstance(rule, Just):
        return type(value) is type(rule.value) and bool(value == rule.value)
    if isinstance(rule, Choice):
        return isinstance(value, str) and value in rule.values
    found = rule if isinstance(rule, Number) else _NAMED[rule][1]
    return found.fits(value) if isinstance(found, Number) else isinstance(value, found)


def require(what: str, value: Any, rule: Any, error: type[Exception] = ValueError) -> None:
    """Raise `error` of one line, "{what} is {value}, expected …", where the value does not fit."""
    if not fits(value, rule):
        is_name = isinstance(rule, Choice) and isinstance(value, str) and value.isprintable()
        raise error(f"{what} is {value if is_name else shown(value)}, expected {words(rule)}")


def check_form(value: Any, rule: Any, where: str = "") -> None:
    """Raise ValueError naming the first part that does not fit."""
    if isinstance(rule, Maybe) and isinstance(rule.rule, list | Mapping):
        if value is not None:
            check_form(value, rule.rule, where)
    elif isinstance(rule, list):
        _must(value, list, where)
        for i, item in enumerate(value):
            check_form(item, rule[0], f"{where}[{i}]")
    elif isinstance(rule, Mapping):
        _must(value, dict, where)
        _check_keys(value, rule, where)
    else:
        _must(value, rule, where)


def _check_keys(value: dict[str, Any], form: Mapping[Any, Any], where: str) -> None:
    named = {key.removesuffix("?") for key in form if isinstance(key, str)}
    for key, inner in form.items():
        if isinstance(key, type):
            for name, item in ((n, i) for n, i in value.items() if n not in named):
                if key is float and not _is_numeral(name):
                    raise ValueError(f"{_after(where)}has the key {name[:60]!r}, expected a number")
                check_form(item, inner, f"{where}.{name[:60]}".lstrip("."))
            continue
        name = key.removesuffix("?")
        if name in value:
            check_form(value[name], inner, f"{where}.{name}".lstrip("."))
        elif name == key:
            raise ValueError(f"{_after(where)}has no {name}")


def _is_numeral(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _must(value: Any, rule: Any, where: str) -> None:
    if not fits(value, rule):
        raise ValueError(f"{_after(where)}is {shown(value)}, expected {words(rule)}")


def _after(where: str) -> str:
    return f"{where} " if where else ""


def _figure(value: float) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:g}"
