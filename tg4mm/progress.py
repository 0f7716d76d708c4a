"""Progress of a long job with the time left: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol, TextIO

PLAIN_EVERY_S = 5.0
_EARLY = 100  # a first report of less than this part of the job is none to tell the time left by


class Update(Protocol):
    """`update(done, psnr=28.3)`: `done` units are finished in all; figures are shown beside them."""

    def __call__(self, done: int, **figures: Any) -> None: ...


@contextmanager
def progress(label: str, total: int, unit: str = "it", start: int = 0) -> Iterator[Update]:
    """Show how far a job of `total` units is, on stderr; `start` units were finished before (a resume).

    Yields `update(done, **figures)`. The end is reported too, with the time the job took.
    """
    show = _bar if sys.stderr.isatty() else _lines
    with show(label, total, unit, start) as update:
        yield update


@contextmanager
def _bar(label: str, total: int, unit: str, start: int) -> Iterator[Update]:
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
    with Progress(*columns, console=Console(stderr=True), refresh_per_second=4) as bar:
        task = bar.add_task(label, total=total, completed=start, figures="")

        def update(done: int, **figures: Any) -> None:
            bar.update(task, completed=done, figures=_figures(figures))

        yield update


@contextmanager
def _lines(label: str, total: int, unit: str, start: int) -> Iterator[Update]:
    state = PlainProgress(label, total, unit, start, stream=sys.stderr)
    yield state.update
    state.finish()


class PlainProgress:
    """Progress as lines of text, at most one every `PLAIN_EVERY_S` seconds, for logs and pipes."""

    def __init__(
        self,
        label: str,
        total: int,
        unit: str,
        start: int,
        stream: TextIO,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._label, self._total, self._unit, self._start = label, total, unit, start
        self._stream, self._clock = stream, clock
        self._began = self._printed = clock()
        self._done, self._text = start, ""
        # when, and how far the job was, from where its speed is measured
        self._base: tuple[float, int] | None = None

    def update(self, done: int, **figures: Any) -> None:
        self._done, self._text = done, _figures(figures)
        now = self._clock()
        if self._base is None and done > self._start:
            # What is done once, compiling kernels say, falls to the first of many units: it tells nothing of the rest.
            early = (done - self._start) * _EARLY < self._total - self._start
            self._base = (now, done) if early else (self._began, self._start)
        if now - self._printed >= PLAIN_EVERY_S and done < self._total:
            self._printed = now
            elapsed = now - self._began
            self._print(f"{clock_text(elapsed)} elapsed, {self._left(now)}")

    def finish(self) -> None:
        self._print(f"took {clock_text(self._clock() - self._began)}")

    def _left(self, now: float) -> str:
        began, start = self._base or (now, self._done)
        made = self._done - start
        if made <= 0:
            return "time left unknown"
        return f"{clock_text((now - began) * (self._total - self._done) / made)} left"

    def _print(self, times: str) -> None:
        tail = f", {self._text}" if self._text else ""
        self._stream.write(f"{self._label}: {self._done}/{self._total} {self._unit}, {times}{tail}\n")
        self._stream.flush()


def clock_text(seconds: float) -> str:
    """Seconds as m:ss or h:mm:ss."""
    minutes, s = divmod(round(seconds), 60)
    hours, m = divmod(minutes, 60)
    return f"{hours}:{m:02d}:{s:02d}" if hours else f"{m}:{s:02d}"


def _figures(figures: dict[str, Any]) -> str:
    return ", ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in figures.items())
