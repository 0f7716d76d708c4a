"""`python -m tg4mm` is the program `tg4mm`."""

import sys

from tg4mm.cli import main

if __name__ == "__main__":
    sys.exit(main())
