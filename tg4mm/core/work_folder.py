"""A folder that belongs to one request: made for it, gone on with for the same one, refused to any other.

What was asked for stands in a JSON file of the folder, its record. Files of unfinished work lie beside it under
temporary names; a kill loses what was not finished, and nothing else. Needs Python's own library alone, and for the
lock the package filelock: inside Blender's own Python, which lacks it, nothing is held.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tg4mm.core.errors import RunError, Tg4mmError, system_says
from tg4mm.core.files import give_back, write_json
from tg4mm.core.temporary import is_temporary, remove_leftovers
from tg4mm.core.untrusted import read_json

LOCK = ".lock"  # in the folder, while a process holds it
_LONGEST = 80  # characters of a value in a message


@dataclass(frozen=True)
class WorkFolder:
    """`path` with its record, a file name. Errors are of the class `error`."""

    path: Path
    record: str
    error: type[Tg4mmError] = RunError
    # a folder with matching files (glob patterns) but no record is not ours and is refused
    strangers: str = "*"
    # of values that are too long to be shown, or say nothing: what is said where they differ, by their first name
    others: Mapping[str, str] = field(default_factory=dict)
    free: tuple[str, ...] = ()  # first names of values that a later request may change

    @contextmanager
    def held(self, busy: str) -> Iterator[None]:
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
            if is_new and {p.name for p in self.path.iterdir()} <= {
                self.record,
                LOCK,
            }:  # refused before any work
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
        held = [p.name for p in self.path.glob(self.strangers) if p.name != LOCK and not is_temporary(p)]
        if held and not self._file.exists():  # which another process may have written just now
            raise self.error(
                f"{self.path} is not empty and holds no {self.record}, but {min(held)!r}: give another folder"
            )

    def read(self) -> dict[str, Any] | None:
        """Return the record's contents, or None if there is none. Raises if it is not a JSON object."""
        if not self._file.exists():
            return None
        try:
            found = read_json(self._file, finite=True)
        except (OSError, ValueError) as error:
            raise self.error(f"{self._file} is not readable JSON: {error}") from None
        if not isinstance(found, dict):
            raise self.error(f"{self._file} holds {type(found).__name__}, expected an object")
        return found

    def claim(
        self,
        asked: Mapping[str, Any],
        record: Mapping[str, Any] | None = None,
        asked_of: Callable[[dict[str, Any]], Mapping[str, Any]] = dict,
    ) -> None:
        """Make the folder for a request (JSON values), or go on in one that was made for the same.

        record: what is written, if more than `asked`. asked_of: from what a record holds to what was asked then.
        Raises where the folder holds something else, naming the first value that differs, and where it cannot be
        written.
        """
        self.check()
        if (found := self.read()) is None:
            made = [folder for folder in (self.path, *self.path.parents) if not folder.exists()]
            try:
                self.path.mkdir(parents=True, exist_ok=True)
                write_json(self._file, dict(asked if record is None else record))
            except OSError as error:
                for folder in made:
                    with suppress(OSError):
                        folder.rmdir()
                raise self.error(f"{self.path} cannot be written: {system_says(error)}") from error
            return
        self._check_same(flat(asked_of(found)), flat(json.loads(json.dumps(asked))))
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
                f"{self.path} was made with {key} = {_shown(old, key)}, asked is {_shown(new, key)}: "
                "give the same value, or another folder"
            )


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
