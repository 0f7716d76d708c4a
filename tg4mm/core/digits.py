"""Numbers as text, with as many digits as are known; sizes, round numbers for axes, tables as text."""

import math
from collections.abc import Sequence

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def value_with_deviation(value: float, deviation: float | None) -> str:
    """`0.223 ± 0.008`: as many digits as the standard deviation has two of; four where there is none."""
    if deviation is None or not math.isfinite(deviation) or deviation <= 0:
        return f"{value:.4g}"
    exponent = math.floor(math.log10(max(abs(value), deviation)))
    power = exponent if exponent < -4 or exponent > 5 else 0
    value, deviation = value / 10.0**power, deviation / 10.0**power
    digits = max(0, 1 - math.floor(math.log10(deviation)))
    text = f"{value:.{digits}f} ± {deviation:.{digits}f}"
    return text if power == 0 else f"({text})e{power}"


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """The rows of a table as lines, each column as wide as its longest cell and two spaces from the next."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]


def number(value: float, digits: int = 3, trim: bool = True) -> str:
    """A number to `digits` significant figures, without an exponent where that stays short.

    `trim` drops zeros at the end, as one does outside tables.
    """
    if value == 0:
        return "0"
    if not math.isfinite(value):
        return "–"
    if 1e-4 <= abs(value) < 1e6:
        places = max(0, digits - 1 - math.floor(math.log10(abs(value))))
        text = f"{value:.{places}f}"
        return text.rstrip("0").rstrip(".") if "." in text and trim else text
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return f"{mantissa.rstrip('0').rstrip('.')}·10{str(int(exponent)).translate(_SUPERSCRIPT)}"


def size_text(size: int) -> str:
    """Bytes as 12.3 kB, 4.56 MB (powers of ten)."""
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= factor:
            return f"{number(size / factor)} {unit}"
    return f"{size} B"


def nice_ticks(low: float, high: float, about: int = 5) -> list[float]:
    """Round numbers (1, 2, 2.5 or 5 times a power of ten apart) that lie in low..high."""
    if not (math.isfinite(low) and math.isfinite(high)) or high <= low:
        return [low]
    raw = (high - low) / max(about - 1, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(m * power for m in (1, 2, 2.5, 5, 10) if m * power >= raw * (1 - 1e-9))
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [float(i * step) for i in range(first, last + 1)]
