"""One process at a time trains a run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tg4mm.core.lock import held
from tg4mm.run.config import check_empty


@contextmanager
def claimed(path: Path | str) -> Iterator[None]:
    """Hold the run folder (`tg4mm.core.lock.held`).

    Raises RunError if another process holds it, or if the folder holds something else than a run.
    """
    path = Path(path)
    if not (path / "config.json").exists():
        check_empty(path)  # a foreign folder gets no lock file either
    with held(path, f"run folder {path} is in use: another process is training it"):
        yield
