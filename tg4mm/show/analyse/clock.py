"""Times of a table's columns: which column holds them, in what unit, and which values they belong to."""

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tg4mm.core.even_clock import is_filled
from tg4mm.show.analyse.tables import AnalyseError

FEWEST = 16  # samples of a channel
TIME_UNITS = {
    "s": 1.0, "ss": 1.0, "second": 1.0, "seconds": 1.0, "secs": 1.0, "ms": 1e-3, "milliseconds": 1e-3,
    "us": 1e-6, "microseconds": 1e-6, "ns": 1e-9, "nanoseconds": 1e-9, "min": 60.0, "minutes": 60.0, "h": 3600.0,
}  # fmt: skip
_NAMES = {
    *(
        "t",
        "time",
        "times",
        "second",
        "seconds",
        "sec",
        "secs",
        "timestamp",
        "time stamp",
        "datetime",
        "date/time",
    ),
    *("date time", "elapsed", "elapsed time", "time elapsed", "seconds elapsed", "relative time", "x value"),
    *("zeit", "zeitstempel", "uhrzeit", "temps", "tiempo", "tempo", "tijd"),
}
_INDICES = {"sample", "samples", "index", "no", "no.", "nr", "nr.", "n", "#", "row", "frame", "point", ""}
_SINCE_1970 = 9e8, 5e9  # seconds, of times from 1998 to 2128
_LOG = logging.getLogger("tg4mm")


def timed(
    path: Path, head: Sequence[tuple[str, str]], table: np.ndarray
) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Return the times in seconds and the values, where they are known, of the columns that hold values.

    head: names and units. A column belongs to the last column of times before it, as where each channel has its own
    clock; else to the first. Raises AnalyseError where there are no times.
    """
    clocks = _clocks(path, head, table)
    out, sparse = dict[int, tuple[np.ndarray, np.ndarray]](), list[str]()
    for k, (name, _) in enumerate(head):
        if k in clocks or _is_index(name, table[:, k]):
            continue
        times, values = clocks[max((at for at in clocks if at < k), default=min(clocks))], table[:, k]
        known = np.isfinite(values) & np.isfinite(times)
        if known.sum() < FEWEST <= len(known):
            sparse += [f"{name} ({known.sum()})"] if name else []
            continue
        out[k] = times[known], values[known]
    if sparse:
        _LOG.warning(f"{path}: columns with fewer than {FEWEST} values are left out: {', '.join(sparse)}")
    return out


def _clocks(path: Path, head: Sequence[tuple[str, str]], table: np.ndarray) -> dict[int, np.ndarray]:
    """Return the columns of times, in seconds, from the first if they count from 1970."""
    named = [k for k, (name, _) in enumerate(head) if _is_name(name)]
    named = named or [k for k, (_, unit) in enumerate(head) if unit in TIME_UNITS and _rises(table[:, k])]
    if not named and not any(name for name, _ in head):
        named = [
            k for k in range(len(head)) if np.isfinite(table[:, k]).all() and not _is_index("", table[:, k])
        ][:1]
        if not named or not _rises(table[:, named[0]]) or not is_filled(table[:, named[0]]):
            raise AnalyseError(f"{path} has neither a head nor times in its first column: name one time_s")
        _LOG.warning(
            f"{path}: has no head; its first column, which rises evenly, is taken as times in seconds"
        )
    if not named:
        columns = ", ".join(f"{name} [{unit}]" if unit else name for name, unit in head)
        raise AnalyseError(f"{path} has no column of times (time_s); its columns: {columns}")
    return {k: _seconds(path, *head[k], table[:, k]) for k in named}


def _seconds(path: Path, name: str, unit: str, times: np.ndarray) -> np.ndarray:
    size = float(np.nanmedian(times))
    since_1970 = [
        factor for factor in (1.0, 1e-3, 1e-6, 1e-9) if _SINCE_1970[0] < size * factor < _SINCE_1970[1]
    ]
    if unit and unit not in TIME_UNITS:
        raise AnalyseError(f"{path}: its times, {name}, are in {unit!r}; expected s, ms, us, ns, min or h")
    factor = TIME_UNITS[unit] if unit else since_1970[0] if since_1970 else 1.0
    if not unit and since_1970 and factor != 1:
        _LOG.warning(f"{path}: its times, {name}, have no unit; they are taken as {factor:g} s since 1970")
    return (times - times[0] if since_1970 else times) * factor


def _is_name(name: str) -> bool:
    return name.lower().replace("_", " ").strip("0123456789 ") in _NAMES


def _rises(values: np.ndarray) -> bool:
    return len(values) > 1 and bool((np.diff(values) >= 0).all() and values[-1] > values[0])


def _is_index(name: str, values: np.ndarray) -> bool:
    """Whether a column numbers the rows."""
    return name.lower() in _INDICES and len(values) > 1 and bool((np.diff(values) == 1).all())
