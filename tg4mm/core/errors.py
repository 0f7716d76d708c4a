"""The one exception family: what a user can mend. The command line prints it as one line and exits with 2."""

import errno

ROOM = "make room there and give the same command again"
_ELSEWHERE = "give another place"
_REMEDIES = {errno.ENOSPC: ROOM, errno.EDQUOT: ROOM, errno.EROFS: _ELSEWHERE, errno.EACCES: _ELSEWHERE}


class Tg4mmError(ValueError):
    """Bad input. The message is one line, names the file or option, and shows the offending value."""

    def __init__(self, message: object = "") -> None:
        super().__init__(one_line(str(message)))


def one_line(text: str) -> str:
    """The text in one line that a terminal may show: a value of a file may hold line ends, or codes of a terminal."""
    joined = " ".join(line.strip() for line in text.splitlines()) if len(text.splitlines()) > 1 else text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in joined)


def system_says(error: OSError, named: bool = False) -> str:
    """Return the operating system's error message with a remedy if known; `named` puts the file name first."""
    where = f"{error.filename}: " if named and error.filename is not None else ""
    remedy = _REMEDIES.get(error.errno or 0)
    return f"{where}{error.strerror or error}{'' if remedy is None else f'; {remedy}'}"


class CaptureError(Tg4mmError):
    """A capture (images, cameras, times) that cannot be read or contradicts itself."""


class MissingSplitError(CaptureError):
    """A capture that has no such split: no test images, say."""


class SplatFileError(Tg4mmError):
    """A splat file that is truncated, foreign, of an unknown version, or holds non-finite numbers."""


class RunError(Tg4mmError):
    """A run folder or checkpoint that is missing, truncated, foreign, or does not fit the request."""


class RegionError(Tg4mmError):
    """A file of regions, a region or a scale that cannot be."""
