"""What a failed job leaves: one line that says why, and a traceback where the error was not foreseen."""

from __future__ import annotations

import traceback
from pathlib import Path

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.files import write_atomic


def why_failed(error: Exception, place: Path) -> str:
    """One line. Of an error that is no message to a user the traceback is written to `place`/traceback.txt."""
    why = str(error) or type(error).__name__
    if isinstance(error, Tg4mmError | OSError | MemoryError):
        return why
    log = place / "traceback.txt"
    log.parent.mkdir(parents=True, exist_ok=True)
    text = "".join(traceback.format_exception(error))
    write_atomic(log, lambda file: file.write_text(text, encoding="utf-8"))
    return f"{type(error).__name__}: {why.splitlines()[0]} ({log})"
