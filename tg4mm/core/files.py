"""Files that are whole or absent: written to a temporary name beside the target, then renamed.

Also what a kill leaves, and how it is removed. Needs Python's own library alone.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import hashlib
import json
import math
import os
import platform
import re
import shlex
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from filelock import BaseFileLock


_HOST = re.sub(r"\W+", "_", platform.node(), flags=re.ASCII)[:40] or "host"
# .<name>.<machine>-<process>.tmp<suffix>; without a machine as former versions wrote it
_FORM = re.compile(r"\.(?P<name>.+)\.(?:(?P<host>\w+)-)?(?P<process>[0-9a-f]+)\.tmp(?:\.\w+)?", re.ASCII)
# Windows neither deletes nor replaces a file that is open or mapped into memory.
WINDOWS = sys.platform == "win32"
_PATIENCE_S = 2.0  # for a virus scanner or an indexer to close a file that was just written
FULL = (errno.ENOSPC, errno.EDQUOT)
_STARTED = time.time() - 1.0  # file systems have coarse clocks
_STALE_S = 3600.0  # since its last change, after which a file is a leftover wherever its writer was


def write_atomic(path: Path, write: Callable[[Path], object]) -> None:
    """Call `write(temporary)` and rename the result to `path`; a kill leaves the old file whole.

    The temporary file lies in the same folder; what killed processes left there is removed.
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


def temporary_name(path: Path, suffix: str = "") -> Path:
    """Return a name beside `path` that no reader takes for data, ending in `suffix` for writers that need it."""
    return path.with_name(f".{path.name}.{_HOST}-{os.getpid()}.tmp{suffix}")


@contextlib.contextmanager
def replacing(path: Path, suffix: str = "") -> Iterator[Path]:
    """A name beside `path` to write to, renamed to it at the end; a kill leaves the old file whole.

    What is at that name is removed where the writing fails, as on a full disk, and what killed processes left in the
    folder. suffix: what the name ends in, for writers that go by that.
    """
    clean_once(path.parent)
    temporary = temporary_name(path, suffix)
    try:
        yield temporary
        flush(temporary)
        rename(temporary, path)
    except OSError as error:  # a full disk is reported without a name, or with the name of the copied file
        if error.errno in FULL or error.filename in (None, str(temporary)):
            raise OSError(error.errno or errno.EIO, error.strerror or str(error), str(path)) from error
        raise
    finally:
        temporary.unlink(missing_ok=True)


def rename(source: Path, target: Path) -> None:
    """`os.replace`, on Windows tried for two seconds while another program has one of the files open."""
    end = time.monotonic() + (_PATIENCE_S if WINDOWS else 0.0)
    while True:
        try:
            return os.replace(source, target)
        except PermissionError:
            if time.monotonic() >= end:
                raise
            time.sleep(0.05)


def flush(path: Path) -> None:
    """Write a file's content to the disk before its name, which after a power failure would have no content."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def is_temporary(path: Path, of: str | None = None) -> bool:
    """Return whether a file has a temporary name; `of` restricts this to temporaries of one target name."""
    form = _FORM.fullmatch(path.name)
    return form is not None and of in (None, form["name"])


def remove_leftovers(folder: Path) -> None:
    """Delete temporary files in `folder` and below whose writer no longer runs.

    A writer on this machine is known by its process; one on another machine counts as gone after an hour without a
    change.
    """
    for path in folder.rglob(".*.tmp*"):
        _remove_if_left(path)


def clean_once(folder: Path) -> None:
    """`remove_leftovers` of the files of `folder` itself, the first time that this process writes there."""
    _clean(str(folder.absolute()), os.getpid())


@functools.lru_cache(maxsize=4096)
def _clean(folder: str, _process: int) -> None:
    with contextlib.suppress(OSError):  # the writing will say it
        for name in os.listdir(folder):
            if name.startswith("."):
                _remove_if_left(Path(folder, name))


def _remove_if_left(path: Path) -> None:
    form = _FORM.fullmatch(path.name)
    if form is None:
        return
    with contextlib.suppress(OSError):  # another process has removed it, or it is not ours
        state = path.stat()
        changed = max(state.st_mtime, state.st_ctime)  # a link has its target's mtime
        here = form["host"] == _HOST and form["process"].isdigit()
        if time.time() - changed > _STALE_S or (here and not _writes(int(form["process"]), changed)):
            path.unlink()


def _writes(process: int, changed: float) -> bool:
    """Return whether a process on this machine may still be writing a file last changed at that time."""
    if process == os.getpid():  # in a container every process may have this number
        return changed >= _STARTED
    return _lives(process)


def _lives(process: int) -> bool:
    if WINDOWS:  # os.kill is Ctrl+C there
        try:
            import psutil
        except ImportError:
            return True
        return psutil.pid_exists(process)
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True
