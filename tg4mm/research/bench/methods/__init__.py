"""What a benchmark compares: anything that is fitted to a dataset and renders its test pictures magnified."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from tg4mm.capture import Capture
from tg4mm.research.bench.request import Plan
from tg4mm.research.bench.sets import BenchSet

Pictures = Iterator[
    tuple[int, np.ndarray]
]  # (index of the capture's image, [H, W, 3] float32 in 0..1 over white)


class Method(Protocol):
    """One job of the benchmark. `place` is a folder of its own for each dataset; both calls are idempotent."""

    @property
    def name(self) -> str:
        """The folder's name, and what `tg4mm bench job` calls it."""
        ...

    @property
    def rows(self) -> tuple[str, ...]:
        """The rows of the tables that it gives: several where one training is magnified in several ways."""
        ...

    def fit(self, data: BenchSet, place: Path, plan: Plan) -> dict[str, Any]:
        """Learn from the training pictures; go on where a killed call was.

        Returned: figures as of `tg4mm.research.bench.measure.measure`, {} for a method that has nothing to learn.
        Raises Tg4mmError where the dataset does not allow it.
        """
        ...

    def recipe(self, row: str, data: BenchSet, place: Path, plan: Plan) -> dict[str, Any]:
        """All that the pictures of a row depend on beside the dataset and α, in JSON's types."""
        ...

    def render(
        self, row: str, data: BenchSet, place: Path, capture: Capture, alpha: float, plan: Plan
    ) -> Pictures:
        """The pictures of the test split `capture`, each once, in any order, magnified by α in the plan's band.

        What is prepared once, such as opening a model, is done when this is called: the pictures themselves are timed.
        """
        ...
