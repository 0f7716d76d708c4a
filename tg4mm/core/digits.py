"""Numbers as text, with as many digits as are known; tables as text."""

import math
from collections.abc import Sequence


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
