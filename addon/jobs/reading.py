"""What a line says that the generator or the core prints: one of their events, or text (tg4mm/core/events.py)."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

_MARK = '{"tg4mm": '  # how an event begins
_LONGEST_EVENT = 20_000  # characters
_LONGEST = 400  # characters of a line that is shown


@dataclass(frozen=True)
class Progress:
    """How far a program is."""

    label: str  # what it does now
    done: int = 0
    total: int = 0  # 0: not known yet
    left_s: float | None = None  # seconds; None: not known

    @property
    def factor(self) -> float:
        """0 … 1."""
        return min(self.done / self.total, 1.0) if self.total > 0 else 0.0

    @property
    def text(self) -> str:
        """For a progress bar."""
        if not self.total:
            return self.label
        left = "" if self.left_s is None else f", {_clock(self.left_s)} left"
        return f"{self.label} {self.done}/{self.total}{left}"


@dataclass(frozen=True)
class Line:
    """One line of a program's output, and what it means; what it does not say is None or empty."""

    text: str
    progress: Progress | None = None
    warning: str = ""
    error: str = ""
    result: str = ""  # a path


def read_line(line: str) -> Line:
    """What a line says. Never raises: programs may print anything."""
    event = _event(line)
    kind, message = event.get("tg4mm"), _shown(event.get("message"))
    if kind == "progress":
        progress = Progress(
            _shown(event.get("label")), _count(event.get("done")), _count(event.get("total")),
            _seconds(event.get("left_s")),
        )  # fmt: skip
        return Line(progress.text, progress)
    if kind == "note":
        return Line(message, Progress(message))
    if kind == "warning":
        return Line(message, warning=message)
    if kind == "error":
        return Line(message, error=message)
    if kind == "complete":
        path = event.get("path")
        return Line(_shown(path), result=path if isinstance(path, str) else "")
    return Line(_shown(line))


def _event(line: str) -> dict[str, Any]:
    """The event that a line is; {} for any other line."""
    text = line.strip()
    if not text.startswith(_MARK) or len(text) > _LONGEST_EVENT:
        return {}
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _shown(value: Any) -> str:
    text = value if isinstance(value, str) else ""
    return "".join(c if c.isprintable() else " " for c in text).strip()[:_LONGEST]


def _count(value: Any) -> int:
    return value if type(value) is int and 0 <= value < 10**12 else 0


def _seconds(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and 0 <= value < math.inf else None


def _clock(seconds: float) -> str:
    """Seconds as m:ss or h:mm:ss."""
    minutes, s = divmod(round(seconds), 60)
    hours, m = divmod(minutes, 60)
    return f"{hours}:{m:02d}:{s:02d}" if hours else f"{m}:{s:02d}"
