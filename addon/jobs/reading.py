"""What a line says that the generator or the core prints: how far it is, a warning, an error, a finished path."""

from __future__ import annotations

import re
from dataclasses import dataclass

# "rendering 12/161  9 s, 156 s left" and "space stage: 120/3000 it, 0:05 elapsed, 2:03 left, psnr 22.1"
_PROGRESS = re.compile(r"(?P<label>\S.*?):? (?P<done>\d+)/(?P<total>\d+)(?P<rest>[ ,].*)?")
_LEFT = re.compile(r"(?:^|[ ,])(?P<left>\d[\d:]*(?: s)?) left\b")
# "compiling kernels for this processor, once: a minute or two in all"
_COMPILING = re.compile(r"(compiling [^,:]+).*")
_COMPLETE = re.compile(r"complete: (?P<path>.+?)(?:  \(\d+ s\))?")
_ERRORS = ("error: ", "tg4mm: ")
_LONGEST = 400  # characters of a line that is shown


@dataclass(frozen=True)
class Progress:
    """How far a program is."""

    label: str  # what it does now
    done: int = 0
    total: int = 0  # 0: not known yet
    left: str = ""  # time left, as the program wrote it

    @property
    def factor(self) -> float:
        """0 … 1."""
        return min(self.done / self.total, 1.0) if self.total > 0 else 0.0

    @property
    def text(self) -> str:
        """For a progress bar."""
        if not self.total:
            return self.label
        return f"{self.label} {self.done}/{self.total}" + (f", {self.left} left" if self.left else "")


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
    text = "".join(c if c.isprintable() else " " for c in line).strip()[:_LONGEST]
    if match := _PROGRESS.fullmatch(text):
        left = _LEFT.search(match["rest"] or "")
        done, total = (int(match[name][:12]) for name in ("done", "total"))
        return Line(text, Progress(match["label"], done, total, left["left"] if left else ""))
    if match := _COMPILING.fullmatch(text):
        return Line(text, Progress(match[1]))
    if text.startswith("warning: "):
        return Line(text, warning=text.removeprefix("warning: "))
    for mark in _ERRORS:
        if text.startswith(mark):
            return Line(text, error=text.removeprefix(mark))
    if match := _COMPLETE.fullmatch(text):
        return Line(text, result=match["path"])
    return Line(text)
