"""The program `tg4mm`: one module per sub-command, nothing heavy imported before a command runs."""

from tg4mm.cli.program import main

__all__ = ["main"]
