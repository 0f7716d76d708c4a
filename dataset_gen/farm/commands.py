"""The commands that make one dataset in parts. A part that is started again skips what is finished."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

MODULE = "dataset_gen"


@dataclass(frozen=True)
class Commands:
    """Argument lists; the first element is the program."""

    prepare: tuple[str, ...]
    parts: tuple[tuple[str, ...], ...]  # in any order, at once, on any machine that sees the folder
    finish: tuple[str, ...]


def commands(python: str, arguments: Sequence[str], out: str, parts: int, processes: int = 0) -> Commands:
    """Commands of the set that `python -m dataset_gen ARGUMENTS --out OUT` makes in one go, in `parts` parts.

    `processes`: render processes at once in each part, 0 for one per core of its machine.
    """
    if parts < 1:
        raise ValueError(f"parts {parts} is below 1")
    if processes < 0:
        raise ValueError(f"processes {processes} is below 0")
    base = (python, "-m", MODULE, *arguments, "--out", out)
    work = ("--processes", str(processes))
    return Commands(
        prepare=(*base, "--prepare", "--parts", str(parts)),
        parts=tuple((*base, "--part", f"{i}/{parts}", *work) for i in range(1, parts + 1)),
        finish=(*base, "--finish"),
    )
