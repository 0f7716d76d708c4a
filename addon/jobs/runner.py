"""Background processes, started, read without blocking, and interrupted; plain Python, no Blender."""

import contextlib
import json
import math
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from tg4mm.core.progress import clock_text

_MARK = '{"tg4mm": '  # how an event begins
_LONGEST_EVENT = 20_000  # characters
_LONGEST = 400  # characters of a line that is shown
PATIENCE_S = 3.0  # between one way of ending a program and the next, harder one
_LISTEN_S = 1.0  # after a program's end, for output that is still under way
_KEPT = 40  # warnings, lines for people
_MOST_LINES = 2000  # taken in one poll, so that a program that floods its output does not block
_WINDOWS = sys.platform == "win32"
# So that a program can be ended together with what it has started.
_OWN_GROUP: dict[str, Any] = {"start_new_session": True}


@dataclass(frozen=True)
class Progress:
    """The progress of a program."""

    label: str  # what it does now
    done: int = 0
    total: int = 0  # 0: not known yet
    left_s: float | None = None  # seconds; None: not known

    @property
    def factor(self) -> float:
        """Return the completed fraction, 0 to 1."""
        return min(self.done / self.total, 1.0) if self.total > 0 else 0.0

    @property
    def text(self) -> str:
        """Return the label of a progress bar."""
        if not self.total:
            return self.label
        left = "" if self.left_s is None else f", {clock_text(self.left_s)} left"
        return f"{self.label} {self.done}/{self.total}{left}"


@dataclass(frozen=True)
class OutputLine:
    """One parsed line of a program's output; fields it lacks are None or empty."""

    text: str
    progress: Progress | None = None
    warning: str = ""
    error: str = ""
    result: str = ""  # a path

    @property
    def is_plain(self) -> bool:
        """Return whether it is text for people, and no event."""
        return bool(self.text) and not (self.progress or self.warning or self.error or self.result)


def read_line(line: str) -> OutputLine:
    """Parse a line. Never raises, because programs may print anything."""
    event = _event(line)
    kind, message = event.get("tg4mm"), _shown(event.get("message"))
    if kind == "progress":
        done, total = (_count(event.get(key)) for key in ("done", "total"))
        progress = Progress(_shown(event.get("label")), done, total, _seconds(event.get("left_s")))
        return OutputLine(progress.text, progress)
    if kind == "note":
        return OutputLine(message, Progress(message))
    if kind == "warning":
        return OutputLine(message, warning=message)
    if kind == "error":
        return OutputLine(message, error=message)
    if kind == "complete":
        path = event.get("path")
        return OutputLine(_shown(path), result=path if isinstance(path, str) else "")
    return OutputLine(_shown(line))


def _event(line: str) -> dict[str, Any]:
    """Return the event in a line, or {} if it is not an event."""
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


if _WINDOWS:
    _OWN_GROUP = {"creationflags": getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)}


class JobState(Enum):
    """The state of a job."""

    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"


@dataclass(frozen=True)
class JobStep:
    """One program of a job."""

    label: str  # what it does, "train": the job shows it until the program says more
    command: tuple[str, ...]
    optional: bool = False  # the job goes on where it fails


class Job:
    """Programs that run one after another, each after the previous one succeeded.

    Whoever owns it calls `poll` a few times a second: only `close` waits, two seconds at most. To read: `state`;
    `progress` of the program that runs; `message`, one line, what went wrong; `results`, paths; `warnings`."""

    def __init__(self, steps: Sequence[JobStep], environment: Mapping[str, str] | None = None) -> None:
        """Start the first program. Raises OSError if it cannot be started, ValueError if there is none."""
        if not steps:
            raise ValueError("a job needs at least one program")
        self._waiting = deque(steps[1:])
        self._environment = dict(os.environ if environment is None else environment)
        self.state, self.message = JobState.RUNNING, ""
        self.progress = Progress(steps[0].label)
        self.results: list[str] = []
        self.warnings: deque[str] = deque(maxlen=_KEPT)
        self.messages: list[str] = []  # the first lines that are for people
        self._asked_at: float | None = None  # when the end was asked for
        self._asked = 0  # how many times
        self._step, self._program = steps[0], _Program(steps[0], self._environment)

    @property
    def running(self) -> bool:
        return self.state is JobState.RUNNING

    @property
    def cancelling(self) -> bool:
        return self.running and self._asked_at is not None

    def poll(self) -> bool:
        """Process new output and state without blocking; return True if something changed."""
        if not self.running:
            return False
        lines = self._program.heard()
        for line in lines:
            self._take(line)
        if self._asked_at is not None and time.monotonic() - self._asked_at > PATIENCE_S * self._asked:
            self._program.end(self._asked)
            self._asked += 1
        if not self._program.over():
            return bool(lines)
        self._finish()
        return True

    def cancel(self) -> None:
        """Interrupt the program as Ctrl+C does. If it does not end, `poll` terminates and finally kills it."""
        if self.running and self._asked_at is None:
            self._asked_at, self._asked = time.monotonic(), 1
            self.message = "Stopping"
            self._program.end(0)

    def close(self) -> None:
        """Terminate the program now, waiting at most two seconds."""
        if not self.running:
            return
        self._asked_at = self._asked_at or time.monotonic()
        for harder in (1, 2):
            self._program.end(harder)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._program.process.wait(1.0)
                break
        self._finish()

    def _take(self, line: OutputLine) -> None:
        if line.progress is not None:
            self.progress = line.progress
        if line.warning:
            self.warnings.append(line.warning)
        if line.result:
            self.results.append(line.result)
        if line.is_plain and len(self.messages) < _KEPT:
            self.messages.append(line.text)

    def _finish(self) -> None:
        status = self._program.process.poll()
        if self._asked_at is not None:
            self._program.end(2)  # whatever the program itself had started
            self._over(JobState.CANCELLED, "Stopped")
        elif status and not self._step.optional:
            error, last = self._program.error, self._program.last or "no output"
            self._over(JobState.FAILED, error or f"ended with status {status}: {last}")
        elif self._waiting:
            self._step = step = self._waiting.popleft()
            self.progress = Progress(step.label)
            try:
                self._program = _Program(step, self._environment)
            except OSError as error:
                self._over(
                    JobState.FAILED, f"{error.filename or 'the program'} cannot be run: {error.strerror}"
                )
        else:
            self._over(JobState.DONE, "")

    def _over(self, state: JobState, message: str) -> None:
        self.state, self.message = state, message


class _Program:
    """A process in its own process group, and a thread that reads its output."""

    def __init__(self, step: JobStep, environment: Mapping[str, str]) -> None:
        """Start the process. Raises OSError if it cannot be started."""
        self.error = self.last = ""  # the last line that says what is wrong; the last line of all
        self._ended_at: float | None = None
        self._silent = False
        self._lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self.process = subprocess.Popen(
            step.command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=environment,
            **_OWN_GROUP,
        )
        assert self.process.stdout is not None
        arguments = (self.process.stdout.fileno(), self.process.stdout, self._lines)
        threading.Thread(target=_read, args=arguments, daemon=True).start()

    def heard(self) -> list[OutputLine]:
        """Return the lines printed since the last call."""
        found: list[OutputLine] = []
        with contextlib.suppress(queue.Empty):
            while len(found) < _MOST_LINES:
                text = self._lines.get_nowait()
                if text is None:
                    self._silent = True
                    break
                found.append(read_line(text))
        for line in found:
            self.error = line.error or self.error
            self.last = self.last if line.progress is not None else line.text or self.last
        return found

    def over(self) -> bool:
        """Return whether it has ended and all of its output was read."""
        if self.process.poll() is None:
            return False
        if self._ended_at is None:
            self._ended_at = time.monotonic()
        # A grandchild may hold the pipe open for ever: its end is waited for, but not long.
        return self._silent or time.monotonic() - self._ended_at >= _LISTEN_S

    def end(self, how: int) -> None:
        """Stop it and its children: 0 interrupts as Ctrl+C does, 1 terminates, 2 kills."""
        with contextlib.suppress(OSError):
            if not _WINDOWS:
                # Its own session: the number of the process is that of its group.
                os.killpg(self.process.pid, (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)[min(how, 2)])
            elif how == 0:
                self.process.send_signal(getattr(signal, "CTRL_BREAK_EVENT", signal.SIGTERM))
            elif self.process.poll() is None:
                kill = ("taskkill", "/T", "/F", "/PID", str(self.process.pid))
                subprocess.Popen(kill, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _read(descriptor: int, stream: Any, lines: queue.SimpleQueue[str | None]) -> None:
    r"""Put every line, ended by \n or \r, into the queue, and None at the end."""
    rest = b""
    with stream, contextlib.suppress(OSError):
        while block := os.read(descriptor, 65536):
            *whole, rest = (rest + block).replace(b"\r", b"\n").split(b"\n")
            for line in whole:
                lines.put(line.decode("utf-8", "replace"))
            rest = rest[-65536:]  # of a line that never ends the end is enough
    if rest:
        lines.put(rest.decode("utf-8", "replace"))
    lines.put(None)
