"""Files that are whole or absent: written to a temporary name beside the target, then renamed."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tg4mm.core.temporary import WINDOWS, replacing

if TYPE_CHECKING:
    from filelock import BaseFileLock


def write_atomic(path: Path, write: Callable[[Path], object]) -> None:
    """Call `write(temporary)` and rename the result to `path`; a kill leaves the old file whole.

    The temporary file lies in the same folder (`tg4mm/core/temporary.py`); what killed processes left there is removed.
    """
    with replacing(path) as temporary:
        write(temporary)


def link_or_copy(source: Path, target: Path) -> None:
    """Make `target` (and its folder) the same file as `source`, or a copy where links are not to be had."""
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source.resolve(), target)
    except OSError:  # another disk, or a file system without links
        write_atomic(target, lambda temporary: shutil.copyfile(source, temporary))


def argument(path: Path | str) -> str:
    """The path as an argument of a command line that is shown: quoted, and no option where it begins with `-`."""
    return shlex.quote(f"./{path}" if str(path).startswith("-") else str(path))


def write_json(path: Path, value: object) -> None:
    """Write `value` as JSON, atomically. NaN and infinity, which JSON lacks, are a ValueError."""
    text = json.dumps(value, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    write_atomic(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def json_digest(value: object) -> str:
    """SHA-256 of JSON values: the same before they are written and when they are read."""
    text = json.dumps(value, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def give_back(lock: BaseFileLock) -> None:
    """Release a lock and delete its file.

    The file is deleted while the lock is held, so that only its holder does it; on Windows afterwards, where the file
    of another holder cannot be deleted.
    """
    file = Path(lock.lock_file)
    if not WINDOWS:
        file.unlink(missing_ok=True)
    lock.release()
    with contextlib.suppress(OSError):
        if WINDOWS:
            file.unlink(missing_ok=True)


def to_json(value: Any, where: str) -> Any:
    """`value` in plain JSON types: tuples become lists, numpy scalars numbers, paths text.

    Raises TypeError naming `where` for anything else, and for NaN and infinity.
    """
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, dict):
        return {_key(k, where): to_json(v, f"{where}.{k}") for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(v, f"{where}[{i}]") for i, v in enumerate(value)]
    if hasattr(value, "item") and getattr(value, "ndim", None) == 0:
        value = value.item()
    if isinstance(value, int | float) and math.isfinite(value):
        return value
    raise TypeError(f"{where} = {value!r} is not a JSON value")


def _key(key: Any, where: str) -> str:
    if not isinstance(key, str):
        raise TypeError(f"{where} has the key {key!r}, which is not text")
    return key
