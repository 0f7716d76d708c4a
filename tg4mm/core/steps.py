"""Steps that fill a folder one after another: finished ones are skipped, what depends on a changed one is made anew."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tg4mm.core.files import write_json
from tg4mm.core.work_folder import WorkFolder

Say = Callable[[str], None]


@dataclass(frozen=True)
class Step:
    """A step: its outputs, inputs and action."""

    name: str
    title: str  # as it is said
    result: Path  # file or folder that is there once the step is done
    work: Callable[[], object]  # goes on by itself where a kill left it
    # JSON values that the result depends on; a function where the steps before it say which
    asked: Mapping[str, Any] | Callable[[], Mapping[str, Any]] = field(default_factory=dict)
    after: Sequence[str] = ()  # names of the steps whose results it reads
    folder: Path | None = None  # holds the result; None: the result itself
    in_place: bool = False  # another request changes the result; else its folder is moved aside first


def run_steps(folder: WorkFolder, record: Mapping[str, Any], steps: Sequence[Step], say: Say) -> None:
    """Do what is left of `steps` in a folder that was claimed with `record`, whose entry `done` holds what is done.

    A step is done again where what it was asked for has changed, where its result is gone, and where a step that it
    reads was done again. A folder made of other input or with other options is kept as NAME_1, NAME_2 …, and said; a
    file is replaced.
    """
    found = (folder.read() or {}).get("done")
    done: dict[str, dict[str, Any]] = (
        {k: v for k, v in found.items() if isinstance(v, dict)} if isinstance(found, dict) else {}
    )

    def write() -> None:
        write_json(folder.path / folder.record, {**record, "done": done})

    for number, step in enumerate(steps, 1):
        label = f"[{number}/{len(steps)}] {step.title}"
        asked = json.loads(json.dumps(step.asked() if callable(step.asked) else step.asked))
        entry = done.get(step.name)
        if entry and entry.get("asked") == asked and "seconds" in entry and step.result.exists():
            say(f"{label}: already done")
            continue
        if (entry is None or entry.get("asked") != asked) and not step.in_place:
            _set_aside(step.folder or step.result, say)
        for name in _dependents(step.name, steps):
            done.pop(name, None)
        done[step.name] = {"asked": asked}  # begun: after a kill the same request goes on
        write()
        say(f"{label} …")
        start = time.monotonic()
        step.work()
        done[step.name]["seconds"] = round(time.monotonic() - start, 2)
        write()
        say(f"{label}: {clock(time.monotonic() - start)}")


def clock(seconds: float) -> str:
    """65 as 1 min 05 s."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"


def _dependents(name: str, steps: Sequence[Step]) -> set[str]:
    """Names of the steps that read the result of `name`, or of one that does."""
    found = {name}
    for step in steps:  # in order, so that one pass is enough
        if found & set(step.after):
            found.add(step.name)
    return found - {name}


def _set_aside(path: Path, say: Say) -> None:
    if not path.is_dir() or not any(path.iterdir()):
        return
    number = 1
    while (kept := path.with_name(f"{path.name}_{number}")).exists():
        number += 1
    path.rename(kept)
    say(f"{path} was made of other input or with other options: kept as {kept.name}")
