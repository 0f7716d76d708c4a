"""One process at a time trains a run: a lock that the system takes back when its holder dies, however it dies."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from tg4mm.errors import RunError
from tg4mm.files import give_back
from tg4mm.run.config import LOCK, check_empty


@contextmanager
def claimed(path: Path | str) -> Iterator[None]:
    """Hold RUN/.lock, making the folder if there is none; take both back at the end if nothing else came to lie there.

    Raises RunError if another process holds it, or if the folder holds something else than a run.
    """
    path = Path(path)
    if not (path / "config.json").exists():
        check_empty(path)  # a foreign folder gets no lock file either
    made = not path.exists()
    path.mkdir(parents=True, exist_ok=True)
    lock = FileLock(path / LOCK)
    try:
        lock.acquire(blocking=False)
    except Timeout:
        raise RunError(
            f"run folder {path} is in use: another process is training it; wait for it, or give another run folder"
        ) from None
    try:
        yield
    finally:
        give_back(lock)
        if made and not any(path.iterdir()):
            path.rmdir()
