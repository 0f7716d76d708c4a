"""Which files belong together as frames: `name_0001.ply`, `name_0002.ply` …"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

_NUMBER = re.compile(r"^(?P<stem>.*?)(?P<number>\d+)$")


def stem_and_number(path: Path) -> tuple[str, int] | None:
    """`bell_0007.ply` → ("bell_", 7); None where the name does not end in digits."""
    found = _NUMBER.match(path.stem)
    return None if found is None else (found["stem"], int(found["number"]))


def as_sequence(paths: Sequence[Path]) -> list[Path] | None:
    """The paths in the order of their numbers, if all are one stem's with different numbers, else None."""
    parts = [stem_and_number(path) for path in paths]
    known = [part for part in parts if part is not None]
    stems = {(path.parent, part[0]) for path, part in zip(paths, parts, strict=True) if part is not None}
    numbers = {part[1] for part in known}
    if len(paths) < 2 or len(known) < len(paths) or len(stems) > 1 or len(numbers) < len(paths):
        return None
    return [path for _, path in sorted(zip((n for _, n in known), paths, strict=True))]


def run_around(path: Path) -> list[Path]:
    """The files beside `path` with its stem and suffix whose numbers, without a gap, lead to its own.

    Only `path` itself where it has no number or no neighbour.
    """
    own = stem_and_number(path)
    if own is None:
        return [path]
    beside: dict[int, Path] = {}
    for other in sorted(path.parent.glob(f"*{path.suffix}")):
        part = stem_and_number(other)
        # Of `f_1` and `f_01` the one written as `path` is.
        if (
            part is not None
            and part[0] == own[0]
            and (part[1] not in beside or len(other.stem) == len(path.stem))
        ):
            beside[part[1]] = other
    beside[own[1]] = path
    first = last = own[1]
    while first - 1 in beside:
        first -= 1
    while last + 1 in beside:
        last += 1
    return [beside[i] for i in range(first, last + 1)]


def missing_beside(path: Path) -> list[int]:
    """The first number of every gap in the numbers of `path` and the files of its stem beside it."""
    own = stem_and_number(path)
    parts = map(stem_and_number, path.parent.glob(f"*{path.suffix}"))
    numbers = {part[1] for part in parts if own is not None and part is not None and part[0] == own[0]}
    return [n + 1 for n in sorted(numbers)[:-1] if n + 1 not in numbers]


def name_of(paths: Sequence[Path]) -> str:
    """A name for a sequence: its stem without what joins it to the number."""
    part = stem_and_number(paths[0])
    return (part[0].rstrip("_-. ") if part else "") or paths[0].parent.name or "splats"
