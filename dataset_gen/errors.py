"""The generator's own error."""

from __future__ import annotations

import sys

from tg4mm.core.errors import Tg4mmError


class GenerateError(Tg4mmError):
    """A dataset that cannot be generated as asked. One line, with the option or file and its value."""


def blender_remedy() -> str:
    """How to get Blender's Python module, which comes for two versions of Python alone."""
    have = sys.version_info[:2]
    if have in ((3, 11), (3, 13)):
        return "pip install '.[generate]' in a copy of the repository"
    version = ".".join(map(str, have))
    return (
        f"this is Python {version}, and Blender's module comes for 3.11 (Blender 4.5) and 3.13 (5.3) alone: make an "
        "environment with one of these"
    )
