"""Edit lists of MP4 and QuickTime files (ISO/IEC 14496-12, 8.6.6): whether they cut a video or change its speed."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

_SUFFIXES = (".mp4", ".mov", ".m4v", ".3gp")
_NORMAL = 1 << 16  # the speed of an edit, in 16.16 bits
_MOST = 1000  # boxes, and entries of a list, that are looked at


def has_cuts(path: Path) -> bool:
    """Whether a video's edit list shows more than one stretch of it, or one at another speed than it was recorded at.

    FFmpeg knows no speeds, and shows what lies between two stretches of slow motion twice.
    """
    if path.suffix.lower() not in _SUFFIXES:
        return False
    with path.open("rb") as file:
        whole = 0, file.seek(0, 2)
        videos = (t for t in _inside(file, whole, b"moov", b"trak") if _is_video(file, t))
        return any(_cuts(file, *edits) for t in videos for edits in _inside(file, t, b"edts", b"elst"))


def _inside(file: BinaryIO, span: tuple[int, int], *kinds: bytes) -> list[tuple[int, int]]:
    """Start and end of the contents of all boxes of the last kind, in those of the kinds before it."""
    spans = [span]
    for kind in kinds:
        spans = [(a, b) for span in spans for found, a, b in _boxes(file, *span) if found == kind]
    return spans


def _is_video(file: BinaryIO, track: tuple[int, int]) -> bool:
    for start, _ in _inside(file, track, b"mdia", b"hdlr"):
        file.seek(start + 8)
        return file.read(4) == b"vide"
    return False


def _boxes(file: BinaryIO, start: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Kind, start and end of the contents of the boxes that lie in a stretch of the file."""
    for _ in range(_MOST):
        file.seek(start)
        head = file.read(16)
        if end - start < 8 or len(head) < 8:
            return
        size, kind = struct.unpack_from(">I4s", head)
        inner = start + 8
        if size == 1 and len(head) == 16:
            size, inner = struct.unpack_from(">Q", head, 8)[0], start + 16
        stop = end if size == 0 else start + size
        if not inner <= stop <= end:
            return
        yield kind, inner, stop
        start = stop


def _cuts(file: BinaryIO, start: int, end: int) -> bool:
    """Whether an edit list does more than to say where the track begins."""
    file.seek(start)
    data = file.read(min(end - start, 8 + 20 * _MOST))
    if len(data) < 8:
        return False
    version, count = data[0], struct.unpack_from(">I", data, 4)[0]
    layout = struct.Struct(">Qqi" if version == 1 else ">Iii")
    count = min(count, (len(data) - 8) // layout.size)
    edits = [layout.unpack_from(data, 8 + k * layout.size) for k in range(count)]
    shown = [(media, speed) for _, media, speed in edits if media >= 0]
    return len(shown) > 1 or any(speed != _NORMAL for _, speed in shown)
