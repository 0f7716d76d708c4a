"""Text into a file, whole or not at all; what the system says about files, in one line."""

from __future__ import annotations

import errno
import os
import tempfile
from pathlib import Path


def one_line(error: OSError, done: str, path: Path | str = "") -> str:
    """What a person reads of an error of the system: the file, what could not be done with it, why."""
    return f"{path or error.filename or 'a file'}: cannot be {done}: {error.strerror or error}"


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 beside `path` under another name, then rename. Raises OSError and leaves what was there."""
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "it is no ordinary file", str(path))
    handle, partial = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name[:40]}.", suffix=".partial")
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as file:
            file.write(text)
        os.chmod(partial, 0o666 & ~_umask())
        os.replace(partial, path)
    except BaseException:
        Path(partial).unlink(missing_ok=True)
        raise


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
