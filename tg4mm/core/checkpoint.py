"""The checkpoint of a run's unfinished stage, saved now and then beside the seconds that the stage has taken."""

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

from tg4mm.core.errors import RunError

CHEAP_S = 0.4  # if saving takes longer, saves are so many times rarer
Stored = tuple[dict[str, Any], dict[str, Any]]  # tensors by name, and the rest of the state, in JSON's types
Check = Callable[[Mapping[str, Any], Mapping[str, Any]], None]  # raises RunError


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


class Checkpoint:
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
