"""What the harness knows of a reader: its sample, how it reads, what may happen to the file."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.faults.mutate import Mutation


@dataclass(frozen=True)
class Reader:
    """`make(folder)` writes the sample and gives the file that is mutated, `read(folder)` reads all of it."""

    make: Callable[[Path], Path]
    read: Callable[[Path], object]
    mutate: Mutation


def record(name: str, values: Any, *folders: str) -> Callable[[Path], Path]:
    """Writes a JSON file that is nothing but these values."""

    def make(root: Path) -> Path:
        file = root.joinpath(*folders, name)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(values))
        return file

    return make


def sealed(name: str, values: dict[str, Any], *folders: str) -> Callable[[Path], Path]:
    """Writes a JSON file with a digest."""

    def make(root: Path) -> Path:
        from tg4mm.core.records import write_sealed

        file = root.joinpath(*folders, name)
        file.parent.mkdir(parents=True, exist_ok=True)
        write_sealed(file, values)
        return file

    return make
