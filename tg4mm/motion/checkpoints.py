"""Parts of a fit that are worth keeping: each is computed once, and a run that was stopped goes on after the last.

A part is a name and a function that gives named arrays. `computed` keeps nothing; `stage.py` keeps them in the run.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

Arrays = dict[str, np.ndarray]


class Parts(Protocol):
    """`parts(name, compute)`: what `compute()` gives, or gave before the run was stopped."""

    def __call__(self, name: str, compute: Callable[[], Arrays]) -> Arrays: ...


def computed(name: str, compute: Callable[[], Arrays]) -> Arrays:
    """Nothing is kept."""
    return compute()
