"""Command line: `python -m dataset_gen.report FOLDER…` writes the reports of finished datasets again."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from tg4mm.core.errors import Tg4mmError

from . import write_report


def main(argv: Sequence[str] | None = None) -> int:
    """Returns 0 if all pages were written, 2 on bad input (one line says what)."""
    parser = argparse.ArgumentParser(prog="python -m dataset_gen.report", description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER", help="of a finished dataset")
    try:
        for folder in parser.parse_args(argv).folders:
            print(write_report(folder))
    except Tg4mmError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
