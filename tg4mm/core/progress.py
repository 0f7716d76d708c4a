"""Progress and messages of a running command: a bar on a terminal, plain lines elsewhere, or events.

With TG4MM_EVENTS=json an event is one line of JSON on stderr, with the key `tg4mm` first; other lines are not meant for
programs.

    {"tg4mm": "progress", "label": "space stage", "done": 120, "total": 3000, "unit": "it", "elapsed_s": 5.2,
     "left_s": 123.1, "figures": {"psnr_db": 22.1}}       left_s null: not known yet
    {"tg4mm": "note", "message": "compiling kernels …"}   also "warning" and "error"
    {"tg4mm": "complete", "path": "/data/mic_5Hz_0_005"}
"""

import importlib.util
import io
import json
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, Protocol, TextIO

from tg4mm.core.errors import one_line

VARIABLE = "TG4MM_EVENTS"
PLAIN_FIRST_S = 2.0
PLAIN_EVERY_S = 5.0
EVENTS_EVERY_S = 0.5
_PULSE_S = 1.0  # between looks whether a job that reports nothing is to be shown all the same
_EARLY = 100  # a first report of less than this part of the job does not predict the time left
_FEW_FIRST_S, _FEW_GROWTH = 10.0, 1.3  # seconds to the first of few lines, and by what the next takes longer


def events_wanted() -> bool:
    """Return whether events are requested."""
    return os.environ.get(VARIABLE) == "json"


def print_any_text() -> None:
    """Print characters that stdout's encoding lacks as "?", such as α in a pipe on Windows."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")


def emit_event(event: str, stream: TextIO | None = None, **fields: Any) -> None:
    """Write one event to `stream`, stderr by default. Figures that JSON cannot hold are written as text."""
    stream = stream or sys.stderr
    # A line in one call, in ASCII: lines of several threads do not mix, and any encoding takes it.
    stream.write(json.dumps({"tg4mm": event, **fields}, default=str) + "\n")
    stream.flush()


def say(event: str, message: str, prefix: str = "", stream: TextIO | None = None) -> None:
    """A note, warning or error: `prefix` and message for people, or the event."""
    if events_wanted():
        emit_event(event, stream, message=message)
    else:
        print(one_line(f"{prefix}{message}"), file=stream or sys.stderr)


@dataclass
class _Few:
    """Schedule of the lines of progress of all jobs, if only few are wanted."""

    due: float
    every_s: float = _FEW_FIRST_S

    def take(self, now: float) -> bool:
        """Return whether a line may be shown now; if so, the wait for the next one grows."""
        if now < self.due:
            return False
        self.every_s *= _FEW_GROWTH
        self.due = now + self.every_s
        return True


_few: ContextVar[_Few | None] = ContextVar("few", default=None)


@contextmanager
def few_lines() -> Iterator[None]:
    """Let jobs share their lines of progress: ever further apart, about 20 in an hour, without finished bars."""
    token = _few.set(_Few(time.monotonic() + _FEW_FIRST_S))
    try:
        yield
    finally:
        _few.reset(token)


_listener: ContextVar[Callable[[str], None] | None] = ContextVar("listener", default=None)


class Update(Protocol):
    """`update(done, psnr=28.3)`: `done` units are finished in all; figures are shown beside them."""

    def __call__(self, done: int, **figures: Any) -> None: ...


@contextmanager
def progress(
    label: str,
    total: int,
    unit: str = "it",
    start: int = 0,
    brief: bool = False,
    stream: TextIO | None = None,
) -> Iterator[Update]:
    """Show how far a job of `total` units is, on `stream` (stderr); `start` units were finished before (a resume).

    Yields `update(done, **figures)`. Between two calls of it, too, the job is shown with the time that passes: one that
    cannot be counted is a job of one unit. The end is reported with the time the job took. brief: the job may take
    hardly any time, and is only heard of where it takes long.
    """
    stream = stream or sys.stderr
    bar = stream.isatty() and not events_wanted() and importlib.util.find_spec("rich") is not None
    brief = brief or (bar and _few.get() is not None)
    show = _bar if bar else _lines
    listener = _listener.get()
    heard = None if listener is None else HeardProgress(label, total, unit, start, stream, listener=listener)
    with show(label, total, unit, start, brief, stream) as update:
        if heard is None:
            yield update
            return

        def both(done: int, **figures: Any) -> None:
            update(done, **figures)
            heard.update(done, **figures)

        yield both


@contextmanager
def listened_to(listener: Callable[[str], None]) -> Iterator[None]:
    """Call `listener` with a line of text about this thread's progress, at most twice a second."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


@contextmanager
def _bar(label: str, total: int, unit: str, start: int, brief: bool, stream: TextIO) -> Iterator[Update]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit, markup=False),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[figures]}", markup=False),
    )
    console = Console(file=stream)
    with Progress(*columns, console=console, refresh_per_second=4, transient=brief) as bar:
        task = bar.add_task(label, total=total, completed=start, figures="")

        def update(done: int, **figures: Any) -> None:
            bar.update(task, completed=done, figures=_figures(figures))

        yield update


@contextmanager
def _lines(label: str, total: int, unit: str, start: int, brief: bool, stream: TextIO) -> Iterator[Update]:
    kind = EventProgress if events_wanted() else PlainProgress
    state = kind(label, total, unit, start, stream, brief=brief)
    with _ticking(state):
        yield state.update
    state.finish()


@contextmanager
def _ticking(state: "PlainProgress") -> Iterator[None]:
    """A thread that lets a job be shown while it reports nothing."""
    ended = threading.Event()

    def tick() -> None:
        with suppress(OSError, ValueError):  # nobody reads any more, which the job itself will meet
            while not ended.wait(_PULSE_S):
                state.tick()

    thread = threading.Thread(target=tick, name="progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


class PlainProgress:
    """Progress as lines of text, the first after `first_s` seconds, then one every `every_s`, for logs and pipes."""

    first_s, every_s = PLAIN_FIRST_S, PLAIN_EVERY_S
    may_be_few = True  # within `few_lines`

    def __init__(
        self,
        label: str,
        total: int,
        unit: str,
        start: int,
        stream: TextIO,
        clock: Callable[[], float] = time.monotonic,
        brief: bool = False,
    ) -> None:
        self._label, self._total, self._unit, self._start = label, total, unit, start
        self._stream, self._clock, self._brief = stream, clock, brief
        self._few = _few.get() if self.may_be_few else None
        self._began = clock()
        self._due = self._began + self.first_s
        self._was_shown = False
        self._lock = threading.Lock()
        self._done, self._figures = start, dict[str, Any]()
        # when, and how far the job was, from where its speed is measured
        self._base: tuple[float, int] | None = None

    def update(self, done: int, **figures: Any) -> None:
        """Report the number of finished units."""
        with self._lock:
            self._done, self._figures = done, figures
            now = self._clock()
            if self._base is None and done > self._start:
                # Work that is done once, such as compiling kernels, falls to the first of many units.
                early = (done - self._start) * _EARLY < self._total - self._start
                self._base = (now, done) if early else (self._began, self._start)
            if done < self._total:
                self._show_if_due(now)

    def tick(self) -> None:
        """Show the passing time if a line is due."""
        with self._lock:
            self._show_if_due(self._clock())

    def finish(self) -> None:
        """The job is over."""
        if self._few is None and (self._was_shown or not self._brief):
            self._ended(self._clock() - self._began)

    def _show_if_due(self, now: float) -> None:
        if now >= self._due and (self._few is None or self._few.take(now)):
            self._due, self._was_shown = now + self.every_s, True
            self._show(now - self._began, self._left_s(now) if self._done < self._total else None)

    def _left_s(self, now: float) -> float | None:
        began, start = self._base or (now, self._done)
        made = self._done - start
        if made <= 0:
            return None
        return (now - began) * (self._total - self._done) / made

    def _show(self, elapsed_s: float, left_s: float | None) -> None:
        self._print(f"{clock_text(elapsed_s)} elapsed, {_left_text(left_s)}")

    def _ended(self, elapsed_s: float) -> None:
        self._print(f"took {clock_text(elapsed_s)}")

    def _print(self, times: str) -> None:
        text = _figures(self._figures)
        tail = f", {text}" if text else ""
        self._stream.write(f"{self._label}: {self._done}/{self._total} {self._unit}, {times}{tail}\n")
        self._stream.flush()


class HeardProgress(PlainProgress):
    """Progress reported to a listener (`listened_to`)."""

    first_s = every_s = EVENTS_EVERY_S
    may_be_few = False

    def __init__(self, *args: Any, listener: Callable[[str], None], **options: Any) -> None:
        super().__init__(*args, **options)
        self._listener = listener

    def _show(self, elapsed_s: float, left_s: float | None) -> None:
        self._listener(f"{self._label}: {self._done} of {self._total} {self._unit}, {_left_text(left_s)}")


class EventProgress(PlainProgress):
    """Progress as events."""

    first_s = every_s = EVENTS_EVERY_S
    may_be_few = False

    def _show(self, elapsed_s: float, left_s: float | None) -> None:
        emit_event(
            "progress", self._stream, label=self._label, done=self._done, total=self._total, unit=self._unit,
            elapsed_s=round(elapsed_s, 1), left_s=None if left_s is None else round(left_s, 1),
            figures=self._figures,
        )  # fmt: skip

    def _ended(self, elapsed_s: float) -> None:
        self._show(elapsed_s, 0.0 if self._done >= self._total else None)


def _left_text(seconds: float | None) -> str:
    return "time left unknown" if seconds is None else f"{clock_text(seconds)} left"


def clock_text(seconds: float) -> str:
    """Seconds as m:ss or h:mm:ss."""
    minutes, s = divmod(round(seconds), 60)
    hours, m = divmod(minutes, 60)
    return f"{hours}:{m:02d}:{s:02d}" if hours else f"{m}:{s:02d}"


def _figures(figures: dict[str, Any]) -> str:
    return ", ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in figures.items())
