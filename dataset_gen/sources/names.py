"""Lists of names in warnings."""

from __future__ import annotations

from collections.abc import Iterable


def list_names(names: Iterable[str], most: int = 6) -> str:
    """Names in order for a warning, the tail counted."""
    ordered = sorted(names)
    shown = ", ".join(ordered[:most])
    return shown if len(ordered) <= most else f"{shown} and {len(ordered) - most} more"
