"""Runs a measurement: `python -m benchmarks NAME [options]`; without a name, the list of them.

A measurement is a module with OPTIONS and `run(options)`. OPTIONS maps each argument to its default, to the type of one
without a default, or to keywords of `add_argument`; False is a flag.
"""

import tg4mm  # noqa: F401, before torch and numba: how their threads wait

# isort: split

import argparse
import ast
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from tg4mm.core.errors import Tg4mmError


def names() -> dict[str, str]:
    """First line of each measurement, by name."""
    found = {}
    for path in sorted(Path(__file__).parent.glob("[!_]*.py")):
        text = path.read_text(encoding="utf-8")
        if "\nOPTIONS" in text:
            found[path.stem] = (ast.get_docstring(ast.parse(text)) or "").partition("\n")[0]
    return found


def add(parser: argparse.ArgumentParser, options: Mapping[str, Any]) -> None:
    """Adds the arguments of OPTIONS."""
    for name, value in options.items():
        if isinstance(value, dict):
            parser.add_argument(name, **value)
        elif value is False:
            parser.add_argument(name, action="store_true")
        elif isinstance(value, type):
            parser.add_argument(name, type=value)
        else:
            parser.add_argument(name, type=type(value), default=value, help="default: %(default)s")


def main(argv: Sequence[str] | None = None) -> int:
    """Run a benchmark; return 0, or 2 on bad input, after a line on it."""
    name, *rest = [*(sys.argv[1:] if argv is None else argv), "--help"]
    known = names()
    if name not in known:
        print(__doc__, *(f"{each:20s} {line}" for each, line in known.items()), sep="\n")
        return 0 if name == "--help" else 2
    module = import_module(f"benchmarks.{name}")
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        f"python -m benchmarks {name}", description=module.__doc__, formatter_class=plain
    )
    add(parser, module.OPTIONS)
    try:
        module.run(parser.parse_args(rest[:-1]))
    except (Tg4mmError, OSError) as error:
        print(f"benchmarks {name}: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
