"""Compares a command's cost here with that in another checkout: processor seconds, seconds and memory, in turns.

    python -m benchmarks beside [--turns 3] [--fresh] OTHER -- process film.mp4 --out OUT

OTHER is a checkout from before a change, such as `git worktree add` makes. `python -m tg4mm` runs there and here in
turn; OUT (or OUT.png) stands for a path that each call gets anew, removed later. The first turn, which compiles kernels
and fills the system's caches, does not count, unless --fresh: then kernels are compiled anew in every call.
"""

import os
import re
import statistics
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tg4mm
from benchmarks.common import Cost, cost, machine
from tg4mm.core.errors import Tg4mmError

OPTIONS: dict[str, Any] = {
    "--turns": 3,
    "--fresh": False,
    "other": {"type": Path, "metavar": "OTHER"},
    "command": {"nargs": "...", "metavar": "-- COMMAND"},
}
_UNITS = ("processor s", "s by the clock", "GiB")


def run(options: Any) -> None:
    """Prints each call's cost, and the medians with their ratio."""
    words = options.command[options.command[:1] == ["--"] :]
    checkouts = {"before": options.other.resolve(), "after": Path(tg4mm.__file__).parents[1]}
    if not words or not (checkouts["before"] / "tg4mm").is_dir():
        raise Tg4mmError("give a checkout of tg4mm, and after -- the words of a command")
    print(machine(), *(f"{name}: {path}" for name, path in checkouts.items()), sep="\n")
    costs: dict[str, list[Cost]] = {name: [] for name in checkouts}
    for turn in range(options.fresh, options.turns + 1):
        for name, path in checkouts.items():
            found = called(path, words, options.fresh)
            cells = (f"{value:.3g} {unit}" for value, unit in zip(found, _UNITS, strict=True))
            print(f"{turn or 'not counted'} {name}: {', '.join(cells)}", flush=True)
            costs[name] += [found] if turn else []
    print(table(costs))


def called(checkout: Path, words: Sequence[str], is_fresh: bool) -> Cost:
    """Return the cost of one call in a folder of its own; a relative path is one from here."""
    with tempfile.TemporaryDirectory() as folder:
        made, own = str(Path(folder) / "out"), {"PYTHONPATH": str(checkout)}
        own |= {"NUMBA_CACHE_DIR": folder} if is_fresh else {}
        shown = [re.sub(r"^OUT\b", lambda _: made, word) for word in words]
        command = [sys.executable, "-P", "-m", "tg4mm", *shown]
        return cost(command, {**os.environ, **own})


def table(costs: dict[str, list[Cost]]) -> str:
    """Medians of each checkout's calls, and the second's over the first's."""
    rows = ["| median | before | after | after over before |", "|:--|--:|--:|--:|"]
    for k, unit in enumerate(_UNITS):
        before, after = (statistics.median(each[k] for each in own) for own in costs.values())
        rows.append(f"| {unit} | {before:.3g} | {after:.3g} | {after / before:.2f} |")
    return "\n".join(rows)
