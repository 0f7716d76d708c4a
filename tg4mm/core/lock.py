"""One process at a time writes into a folder: a lock that the system takes back however its holder dies."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tg4mm.core.errors import RunError
from tg4mm.core.files import give_back

LOCK = ".lock"  # in the folder, while a process holds it


@contextmanager
def held(folder: Path, busy: str) -> Iterator[None]:
    """Hold FOLDER/.lock, making the folder if there is none. At the end both are taken back, the folder if empty.

    Raises RunError with `busy`, which says what the holder does, if another process holds it. Inside Blender's own
    Python, which lacks the package filelock, nothing is held.
    """
    try:
        from filelock import FileLock, Timeout
    except ModuleNotFoundError:
        yield
        return
    made = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / LOCK)
    try:
        lock.acquire(blocking=False)
    except Timeout:
        raise RunError(f"{busy}; wait for it, or give another folder") from None
    try:
        yield
    finally:
        give_back(lock)
        if made and not any(folder.iterdir()):
            folder.rmdir()
