"""From a farm's configuration to its datasets: folders, numbers of parts, commands. The Snakefile asks for it."""

import contextlib
import io
import json
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.untrusted import parse_json
from tg4mm.core.values import Number, require

from ..errors import GenerateError
from ..options import parser, request_from

_KEYS = {"python": str, "out": str, "parts": int, "threads": int, "mem_mb": int, "minutes": int, "options": str,
         "sets": dict}  # fmt: skip
_SET_KEYS = ("options", "parts")
_DEFAULTS: dict[str, Any] = {"parts": 4, "threads": 1, "mem_mb": 4000, "minutes": 240, "options": ""}
MOST_PARTS = 100_000  # of a dataset: each is a job of a scheduler
_MOST = {"parts": MOST_PARTS, "threads": 10_000, "mem_mb": 100_000_000, "minutes": 1_000_000}

MODULE = "dataset_gen"


@dataclass(frozen=True)
class FarmCommands:
    """Argument lists; the first element is the program."""

    prepare: tuple[str, ...]
    parts: tuple[tuple[str, ...], ...]  # in any order, at once, on any machine that sees the folder
    finish: tuple[str, ...]


@dataclass(frozen=True)
class FarmSet:
    """One dataset of a farm."""

    name: str  # in the configuration
    folder: str  # below `out`
    parts: int
    commands: FarmCommands

    def to_json(self) -> dict[str, Any]:
        """Commands as lines for a shell, those of the parts from 1."""
        return {
            "name": self.name,
            "parts": self.parts,
            "prepare": shlex.join(self.commands.prepare),
            "part": [shlex.join(command) for command in self.commands.parts],
            "finish": shlex.join(self.commands.finish),
        }


def farm_sets(config: Mapping[str, Any]) -> list[FarmSet]:
    """The datasets of a configuration (config.yaml beside the Snakefile explains its keys).

    Raises GenerateError, one line with the key or set, for unknown keys, wrong types, options that
    `python -m dataset_gen` refuses, and two sets of one folder.
    """
    values = _checked(config)
    found: dict[str, FarmSet] = {}
    for name, own in values["sets"].items():
        made = _farm_set(name, own or {}, values)
        if made.folder in found:
            other = found[made.folder].name
            raise GenerateError(f"sets {other!r} and {name!r} have the same folder {made.folder}: rename one with "
                                "--name or give them an `out` each")  # fmt: skip
        found[made.folder] = made
    return list(found.values())


def _checked(config: Mapping[str, Any]) -> dict[str, Any]:
    for key, value in config.items():
        if key not in _KEYS:
            raise GenerateError(f"configuration: {key!r} is not one of {', '.join(_KEYS)}")
        if not isinstance(value, _KEYS[key]) or isinstance(value, bool):
            raise GenerateError(f"configuration: {key} is {value!r}, expected {_KEYS[key].__name__}")
    for key in ("out", "python", "options"):
        if not str(config.get(key, "")).isprintable():
            raise GenerateError(f"configuration: {key} is {config[key]!r}, which holds a control character")
    for key, most in _MOST.items():
        require(f"configuration: {key}", config.get(key, 1), Number(1, most, whole=True), GenerateError)
    if config.get("python", "").startswith("-"):
        raise GenerateError(f"configuration: python is {config['python']!r}, expected a program")
    for key in ("out", "sets"):
        if not config.get(key):
            raise GenerateError(f"configuration: {key} is missing")
    return {**_DEFAULTS, "python": sys.executable, **config}


def _farm_set(name: str, own: Any, values: Mapping[str, Any]) -> FarmSet:
    where = f"set {name!r}"
    if not isinstance(own, dict):
        raise GenerateError(f"{where}: is {own!r}, expected {' and '.join(_SET_KEYS)}")
    if unknown := [key for key in own if key not in _SET_KEYS]:
        raise GenerateError(f"{where}: {unknown[0]!r} is not one of {', '.join(_SET_KEYS)}")
    parts = own.get("parts", values["parts"])
    options = own.get("options", name)
    require(f"{where}: parts", parts, Number(1, MOST_PARTS, whole=True), GenerateError)
    require(f"{where}: options", options, str, GenerateError)
    try:
        arguments = [*shlex.split(values["options"]), *shlex.split(options)]  # its own have the last word
        with contextlib.redirect_stdout(io.StringIO()):
            request = request_from(parser().parse_args([*arguments, "--out", values["out"]]))
    except SystemExit:  # --help
        raise GenerateError(f"{where}: options {options!r} ask for help, and make no dataset") from None
    except (Tg4mmError, ValueError) as error:
        raise GenerateError(f"{where}: {error}") from error
    if len(request.sets) != 1:
        raise GenerateError(f"{where}: is {len(request.sets)} datasets; name each as a set of its own")
    if request.prepare or request.part or request.finish or request.save_blend:
        raise GenerateError(
            f"{where}: options hold --prepare, --part, --finish or --save-blend, which the farm adds"
        )
    made = commands(values["python"], arguments, values["out"], parts, values["threads"])
    return FarmSet(name, request.sets[0].folder, parts, made)


def commands(python: str, arguments: Sequence[str], out: str, parts: int, processes: int = 0) -> FarmCommands:
    """Commands of the set that `python -m dataset_gen ARGUMENTS --out OUT` makes in one go, in `parts` parts.

    `processes`: render processes at once in each part, 0 for one per core of its machine.
    """
    if parts < 1:
        raise ValueError(f"parts {parts} is below 1")
    if processes < 0:
        raise ValueError(f"processes {processes} is below 0")
    base = (python, "-m", MODULE, *arguments, "--out", out)
    work = ("--processes", str(processes))
    return FarmCommands(
        prepare=(*base, "--prepare", "--parts", str(parts)),
        parts=tuple((*base, "--part", f"{i}/{parts}", *work) for i in range(1, parts + 1)),
        finish=(*base, "--finish"),
    )


def main() -> int:
    """Reads a configuration as JSON on standard input. Returns 0, or 2 with one line on bad input."""
    try:
        config = parse_json(sys.stdin.read())
        require("configuration", config, dict, GenerateError)
        found = {one.folder: one.to_json() for one in farm_sets(config)}
    except (Tg4mmError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    json.dump(found, sys.stdout)
    return 0


if __name__ == "__main__":
    sys.exit(main())
