"""Progress and messages of a running command: text or, with TG4MM_EVENTS=json, one JSON event per line.

An event is one line of JSON on stderr, with the key `tg4mm` first; what else is printed is not meant for programs.

    {"tg4mm": "progress", "label": "space stage", "done": 120, "total": 3000, "unit": "it", "elapsed_s": 5.2,
     "left_s": 123.1, "figures": {"psnr_db": 22.1}}       left_s null: not known yet
    {"tg4mm": "note", "message": "compiling kernels …"}   also "warning" and "error"
    {"tg4mm": "complete", "path": "/data/mic_5Hz_0_005"}

Needs Python's own library alone.
"""

import io
import json
import os
import sys
from typing import Any, TextIO

from tg4mm.core.errors import one_line

VARIABLE = "TG4MM_EVENTS"


def wanted() -> bool:
    """Return whether events are requested."""
    return os.environ.get(VARIABLE) == "json"


def print_any_text() -> None:
    """Print characters that stdout's encoding lacks as "?", such as α in a pipe on Windows."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")


def emit(event: str, stream: TextIO | None = None, **fields: Any) -> None:
    """Write one event to `stream`, stderr by default. Figures that JSON cannot hold are written as text."""
    stream = stream or sys.stderr
    # A line in one call, in ASCII: lines of several threads do not mix, and any encoding takes it.
    stream.write(json.dumps({"tg4mm": event, **fields}, default=str) + "\n")
    stream.flush()


def say(event: str, message: str, prefix: str = "", stream: TextIO | None = None) -> None:
    """A note, warning or error: `prefix` and message for people, or the event."""
    if wanted():
        emit(event, stream, message=message)
    else:
        print(one_line(f"{prefix}{message}"), file=stream or sys.stderr)
