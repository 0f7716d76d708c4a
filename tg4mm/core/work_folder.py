"""A folder that belongs to one request: created for it, resumed for the same request, refused to any other.

The request is stored in a JSON file of the folder, its record. Files of unfinished work are beside it under temporary
names; a kill loses only unfinished work. Needs only Python's standard library, and the package filelock for the lock:
inside Blender's own Python, which lacks it, nothing is locked.

`run_steps` fills such a folder step by step: finished steps are skipped, steps that depend on a changed one are
repeated. `StageCheckpoint` saves a run's unfinished stage from time to time, with the seconds that it has taken.
"""

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from tg4mm.core.errors import RunError, Tg4mmError, system_says
from tg4mm.core.files import give_back, is_temporary, remove_leftovers, write_json
from tg4mm.core.untrusted import read_json

LOCK = ".lock"  # in the folder, while a process holds it
_LONGEST = 80  # characters of a value in a message

Say = Callable[[str], None]

CHEAP_S = 0.4  # if saving takes longer, saves are so many times rarer
Stored = tuple[dict[str, Any], dict[str, Any]]  # tensors by name, and the rest of the state, in JSON's types
Check = Callable[[Mapping[str, Any], Mapping[str, Any]], None]  # raises RunError


@dataclass(frozen=True)
class WorkFolder:
    """`path` with its record, a file name. Errors are of the class `error`."""

    path: Path
    record: str
    error: type[Tg4mmError] = RunError
    # a folder with matching files (glob patterns) but no record is not ours and is refused
    foreign_files: str = "*"
    # messages for differing values that are too long, or not informative, to show; by their first name
    others: Mapping[str, str] = field(default_factory=dict)
    free: tuple[str, ...] = ()  # first names of values that a later request may change

    @contextmanager
    def locked(self, busy: str) -> Iterator[None]:
        """Hold the folder's lock, making the folder if there is none; the system takes it back however a process dies.

        At the end the lock's file is removed, and the folder if it is empty and was made here; with a Tg4mmError inside
        the record too, where nothing else was made. Raises RunError if
        another process holds it (busy: what that does), and as `check`: a folder of somebody else's gets no lock.
        """
        self.check()
        try:
            from filelock import FileLock, Timeout
        except ModuleNotFoundError:
            yield
            return
        made, is_new = not self.path.exists(), not self._file.exists()
        self.path.mkdir(parents=True, exist_ok=True)
        lock = FileLock(self.path / LOCK)
        try:
            lock.acquire(blocking=False)
        except Timeout:
            raise RunError(
                f"{self.path} is in use: another process {busy}; wait for it, or give another folder"
            ) from None
        try:
            yield
        except Tg4mmError:
            # refused before any work
            if is_new and {p.name for p in self.path.iterdir()} <= {self.record, LOCK}:
                self._file.unlink(missing_ok=True)
            raise
        finally:
            give_back(lock)
            if made and not any(self.path.iterdir()):
                self.path.rmdir()

    def check(self) -> None:
        """Raise where the folder is a file, or holds anything and no record; nothing is made."""
        if self.path.exists() and not self.path.is_dir():
            raise self.error(f"{self.path} is a file, expected a folder")
        if not self.path.is_dir() or self._file.exists():
            return
        # a kill before the record was renamed leaves its temporary file and the lock: still an empty folder
        held = [p.name for p in self.path.glob(self.foreign_files) if p.name != LOCK and not is_temporary(p)]
        if held and not self._file.exists():  # which another process may have written just now
            raise self.error(
                f"{self.path} is not empty and holds no {self.record}, but {min(held)!r}: give another folder"
            )

    def read(self) -> dict[str, Any] | None:
        """Return the record's contents, or None if there is none. Raises if it is not a JSON object."""
        if not self._file.exists():
            return None
        return read_object(self._file, self.error)

    def claim(
        self,
        request: Mapping[str, Any],
        record: Mapping[str, Any] | None = None,
        request_of: Callable[[dict[str, Any]], Mapping[str, Any]] = dict,
    ) -> None:
        """Make the folder for a request (JSON values), or go on in one that was made for the same.

        record: what is written, if more than `request`. request_of: from a record to its request.
        Raises where the folder holds something else, naming the first value that differs, and where it cannot be
        written.
        """
        self.check()
        if (found := self.read()) is None:
            made = [folder for folder in (self.path, *self.path.parents) if not folder.exists()]
            try:
                self.path.mkdir(parents=True, exist_ok=True)
                write_json(self._file, dict(request if record is None else record))
            except OSError as error:
                for folder in made:
                    with suppress(OSError):
                        folder.rmdir()
                raise self.error(f"{self.path} cannot be written: {system_says(error)}") from error
            return
        self._check_same(flat(request_of(found)), flat(json.loads(json.dumps(request))))
        remove_leftovers(self.path)

    @property
    def _file(self) -> Path:
        return self.path / self.record

    def _check_same(self, old: Mapping[str, Any], new: Mapping[str, Any]) -> None:
        for key in [*new, *(k for k in old if k not in new)]:
            first = key.partition(".")[0]
            if first in self.free or ((key in new) == (key in old) and new[key] == old[key]):
                continue
            if first in self.others:
                raise self.error(f"{self.path} was made {self.others[first]}: give another folder")
            raise self.error(
                f"{self.path} was made with {key} = {_shown(old, key)}, not {_shown(new, key)}: "
                "give the same value, or another folder"
            )


def read_object(file: Path, error: type[Tg4mmError] = RunError) -> dict[str, Any]:
    """Read a JSON object. Raises `error` if the file is torn or holds anything else."""
    try:
        found = read_json(file, finite=True)
    except (OSError, ValueError) as problem:
        raise error(f"{file} is not readable JSON: {problem}") from None
    if not isinstance(found, dict):
        raise error(f"{file} holds {type(found).__name__}, expected an object")
    return found


def flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested values by dotted names, as on the command line: {"space": {"seed": 0}} is space.seed."""
    out: dict[str, Any] = {}
    for key, value in values.items():
        nested = isinstance(value, Mapping) and value
        out |= flat(value, f"{prefix}{key}.") if nested else {f"{prefix}{key}": value}
    return out


def _shown(values: Mapping[str, Any], key: str) -> str:
    text = json.dumps(values[key], ensure_ascii=False) if key in values else "(not set)"
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"


@dataclass(frozen=True)
class FolderStep:
    """A step: its outputs, inputs and action."""

    name: str
    title: str  # in messages
    result: Path  # file or folder that is there once the step is done
    work: Callable[[], object]  # goes on by itself where a kill left it
    # JSON values that the result depends on; a function where the steps before it say which
    request: Mapping[str, Any] | Callable[[], Mapping[str, Any]] = field(default_factory=dict)
    after: Sequence[str] = ()  # names of the steps whose results it reads
    folder: Path | None = None  # holds the result; None: the result itself
    in_place: bool = False  # another request changes the result; else its folder is moved aside first


def run_steps(folder: WorkFolder, record: Mapping[str, Any], steps: Sequence[FolderStep], say: Say) -> None:
    """Do the unfinished `steps` in a folder that was claimed with `record`, whose entry `done` lists finished ones.

    A step is done again where what it was asked for has changed, where its result is gone, and where a step that it
    reads was done again. A folder made of other input or with other options is kept as NAME_1, NAME_2 …, and reported;
    a file is replaced.
    """
    found = (folder.read() or {}).get("done")
    done: dict[str, dict[str, Any]] = (
        {k: v for k, v in found.items() if isinstance(v, dict)} if isinstance(found, dict) else {}
    )

    def write() -> None:
        write_json(folder.path / folder.record, {**record, "done": done})

    for number, step in enumerate(steps, 1):
        label = f"[{number}/{len(steps)}] {step.title}"
        request = json.loads(json.dumps(step.request() if callable(step.request) else step.request))
        entry = done.get(step.name)
        if entry and entry.get("asked") == request and "seconds" in entry and step.result.exists():
            say(f"{label}: already done")
            continue
        if (entry is None or entry.get("asked") != request) and not step.in_place:
            _set_aside(step.folder or step.result, say)
        for name in _dependents(step.name, steps):
            done.pop(name, None)
        done[step.name] = {"asked": request}  # begun: after a kill the same request goes on
        write()
        say(f"{label} …")
        start = time.monotonic()
        step.work()
        done[step.name]["seconds"] = round(time.monotonic() - start, 2)
        write()
        say(f"{label}: {clock(time.monotonic() - start)}")


def clock(seconds: float) -> str:
    """65 as 1 min 05 s."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"


def _dependents(name: str, steps: Sequence[FolderStep]) -> set[str]:
    """Names of the steps that read the result of `name`, or of one that does."""
    found = {name}
    for step in steps:  # in order, so that one pass is enough
        if found & set(step.after):
            found.add(step.name)
    return found - {name}


def _set_aside(path: Path, say: Say) -> None:
    if not path.is_dir() or not any(path.iterdir()):
        return
    number = 1
    while (kept := path.with_name(f"{path.name}_{number}")).exists():
        number += 1
    path.rename(kept)
    say(f"{path} was made of other input or with other options: kept as {kept.name}")


class Store(Protocol):
    """A run folder, `tg4mm.run.Run`."""

    def load_checkpoint(self, stage: str) -> Stored | None:
        """Return what was saved last, None if nothing was."""

    def save_checkpoint(self, stage: str, tensors: Mapping[str, Any], state: Mapping[str, Any]) -> None:
        """Replace what was saved."""

    def drop_checkpoint(self, stage: str) -> None:
        """Remove what was saved."""

    def record(self, stage: str, info: Mapping[str, Any]) -> None:
        """Add figures of the stage to the log."""

    def part_file(self, name: str) -> Path:
        """Return the file of a part of the run."""


class StageCheckpoint:
    """The checkpoint of one stage in a store; without a store nothing is saved, and a fit begins anew each time."""

    def __init__(self, store: Store | None = None, stage: str = "") -> None:
        self._store, self.stage = store, stage
        self._recorded = self._saved = time.monotonic()
        self._rarer = 1.0

    @property
    def unrecorded_s(self) -> float:
        """Seconds that the stage has taken and the log does not contain yet."""
        return time.monotonic() - self._recorded

    def load(self, check: Check = lambda tensors, state: None) -> Stored | None:
        """Return what was saved last, None if nothing was.

        Raises RunError, naming the file, if `check` does: the stage cannot continue from it.
        """
        stored = None if self._store is None else self._store.load_checkpoint(self.stage)
        if self._store is None or stored is None:
            return None
        try:
            check(*stored)
        except RunError as error:
            file = self._store.part_file(f"checkpoint_{self.stage}")
            raise RunError(f"{file}: {error}; delete it to start the {self.stage} stage again") from None
        return stored

    def is_due(self, every_s: float) -> bool:
        """Return whether the last save was so many seconds ago; more, if saving takes long."""
        return self._store is not None and time.monotonic() - self._saved > every_s * self._rarer

    def save(self, tensors: Mapping[str, Any], state: Mapping[str, Any], **figures: Any) -> None:
        """Save the state, and add the seconds since the last save and the figures to the log."""
        if self._store is None:
            return
        begun = time.monotonic()
        self._store.save_checkpoint(self.stage, tensors, state)
        self.record(**figures)
        self._saved = time.monotonic()
        self._rarer = max(1.0, (self._saved - begun) / CHEAP_S)

    def record(self, **figures: Any) -> None:
        """Add the seconds since the last call, and figures, to the log."""
        if self._store is not None:
            self._store.record(self.stage, {"seconds": self.unrecorded_s, **figures})
        self._recorded = self._saved = time.monotonic()

    def drop(self) -> None:
        """Remove what was saved: the stage is finished."""
        if self._store is not None:
            self._store.drop_checkpoint(self.stage)
