"""The generator's own error."""

from __future__ import annotations

from tg4mm.errors import Tg4mmError


class GenerateError(Tg4mmError):
    """A dataset that cannot be generated as asked. One line, with the option or file and its value."""
