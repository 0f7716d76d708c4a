"""What a .blend file says of itself before Blender opens it: that it is one, that it is whole, its version."""

from __future__ import annotations

import gzip
import re
import zlib
from pathlib import Path
from typing import BinaryIO

from ..errors import GenerateError

_GZIP, _ZSTD = b"\x1f\x8b", b"\x28\xb5\x2f\xfd"
_TAIL = 64  # bytes; the closing block's header is one of 20, 24 or 32 bytes
# "BLENDER-v405" up to 4.5, with "_" for 32-bit pointers and "V" for big-endian; "BLENDER17-01v0502" since.
_HEAD = re.compile(rb"BLENDER(?:[-_][vV](\d{3})|\d\d-\d\d[vV](\d{4}))")


def check(path: Path, running: tuple[int, int]) -> None:
    """Raises GenerateError, one line with the path, unless `path` is a whole .blend that `running` can read.

    `running` is Blender's version, (major, minor). A file compressed with Zstandard, which Python's library
    does not read, is only known to be one: what is in it shows when Blender opens it.
    """
    try:
        with path.open("rb") as file:
            start = file.read(4)
            if start == _ZSTD:
                return
            file.seek(0)
            if start.startswith(_GZIP):
                with gzip.open(file) as plain:
                    _check_plain(path, plain, running)
            else:
                _check_plain(path, file, running)
    except FileNotFoundError:
        raise GenerateError(f"{path} does not exist") from None
    except IsADirectoryError:
        raise GenerateError(f"{path} is a folder, not a .blend file") from None
    except (EOFError, zlib.error, gzip.BadGzipFile):
        raise GenerateError(f"{path} is cut off or damaged: its compressed data does not end well") from None
    except OSError as error:
        raise GenerateError(f"{path} cannot be read: {error.strerror or error}") from error


def _check_plain(path: Path, file: BinaryIO | gzip.GzipFile, running: tuple[int, int]) -> None:
    found = _HEAD.match(tail := file.read(32))
    if found is None:
        what = "is empty" if not tail else f"is not a .blend file: it begins with {tail[:8]!r}"
        raise GenerateError(f"{path} {what}")
    check_version(path, divmod(int(found[1] or found[2]), 100), running)
    while block := file.read(1 << 20):
        tail = (tail + block)[-_TAIL:]
    if b"ENDB" not in tail:
        raise GenerateError(f"{path} is cut off: the block that closes a .blend file is missing")


def check_version(path: Path, saved: tuple[int, int], running: tuple[int, int]) -> None:
    """Raises GenerateError if a newer Blender than the running one saved the file."""
    if saved > running:
        raise GenerateError(
            f"{path} was saved by Blender {saved[0]}.{saved[1]}, newer than this Blender "
            f"{running[0]}.{running[1]}: use that version, or save the file in this one"
        )
