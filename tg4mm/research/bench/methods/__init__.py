"""The interface of the benchmark's methods, and methods that train a run."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from tg4mm.capture import Capture, load_capture
from tg4mm.core.magnification import Magnification
from tg4mm.research.bench.measure import measure
from tg4mm.research.bench.request import BenchPlan, Scoring, Training
from tg4mm.research.bench.sets import BenchSet
from tg4mm.research.evaluate.run import CEILING, OURS, STATIC
from tg4mm.research.evaluate.scores import ScoredMotion, Subject, render_views, subject_of
from tg4mm.run import Run
from tg4mm.run.tensor_file import model_hash

# (index of the capture's image, [H, W, 3] float32 in 0..1 over white)
Pictures = Iterator[tuple[int, np.ndarray]]
_CAMERAS_AT_ONCE = 8  # pictures held
_VERSION = 1  # of the pictures; to be raised when the same model would give others


class Method(Protocol):
    """A job of the benchmark. `place` is a separate folder for each dataset; both calls are idempotent."""

    @property
    def name(self) -> str:
        """The name of the folder and of the method for `tg4mm bench job`."""
        ...

    @property
    def rows(self) -> tuple[str, ...]:
        """The rows of the tables, several if a training is magnified in several ways."""
        ...

    def fit(self, data: BenchSet, place: Path, plan: BenchPlan) -> dict[str, Any]:
        """Learn from the training pictures, or continue after a killed call.

        Returns figures like `tg4mm.research.bench.measure.measure`, {} for a method without training. Raises
        Tg4mmError if the dataset does not allow it.
        """
        ...

    def recipe(self, row: str, data: BenchSet, place: Path, plan: BenchPlan) -> dict[str, Any]:
        """Return everything that determines a row's pictures beside dataset and α, in JSON's types."""
        ...

    def render(
        self, row: str, data: BenchSet, place: Path, capture: Capture, alpha: float, plan: BenchPlan
    ) -> Pictures:
        """Yield each picture of the test split `capture`, in any order, magnified by α in the plan's band.

        Preparations, such as opening a model, are done by the call, since the iteration is timed.
        """
        ...


@dataclass(frozen=True)
class Trained:
    """A preset, magnified in each of its ways. `framing`: with rows of its Gaussians at rest and moved exactly."""

    training: Training
    framing: bool = False

    @property
    def name(self) -> str:
        return self.training.name.replace(", ", "-").replace(" ", "_").replace("'", "")

    @property
    def rows(self) -> tuple[str, ...]:
        ways = tuple(row_title(self.training.name, way.name) for way in self.training.ways)
        return (STATIC, *ways, CEILING) if self.framing else ways

    def fit(self, data: BenchSet, place: Path, plan: BenchPlan) -> dict[str, Any]:
        _subject_of.cache_clear()  # frees the memory of another run
        return measure(place, data, self.training, plan)

    def recipe(self, row: str, data: BenchSet, place: Path, plan: BenchPlan) -> dict[str, Any]:
        way = self._way(row)
        return {
            "version": _VERSION,
            "model": model_hash(place / "run"),
            "row": row,
            "method": None if way is None else way.method,
            "filter": None if way is None else way.filter,
            "band_hz": plan.band(data),
        }

    def render(
        self, row: str, data: BenchSet, place: Path, capture: Capture, alpha: float, plan: BenchPlan
    ) -> Pictures:
        way = self._way(row)
        run, magnified = place / "run", (way or self.training.ways[0]).magnified(plan.bands(data))
        subject = _subject_of(run, model_hash(run), data.root, magnified, plan.device)
        (method,) = [m for m in subject.methods if m.name == (row if way is None else OURS)]
        if method.posing is not None:  # opens the model, which is not rendering
            method.posing.at(float(alpha))
        return _pictures(subject, method, capture, float(alpha))

    def _way(self, row: str) -> Scoring | None:
        """Return the magnification of a row; None for a row for comparison."""
        return next((w for w in self.training.ways if row_title(self.training.name, w.name) == row), None)


@lru_cache(maxsize=1)  # one at a time: rows and α of one way to magnify follow each other
def _subject_of(run: Path, model: str, root: Path, magnified: Magnification, device: str) -> Subject:
    return subject_of(Run.open(run), load_capture(root), magnified, {}, device)


def _pictures(subject: Subject, method: ScoredMotion, capture: Capture, alpha: float) -> Pictures:
    for t in np.unique(capture.timesteps).tolist():
        gaussians = method.pose(subject.gaussians, t, alpha)
        rows = np.flatnonzero(capture.timesteps == t)
        for first in range(0, len(rows), _CAMERAS_AT_ONCE):
            some = rows[first : first + _CAMERAS_AT_ONCE]
            yield from zip(some.tolist(), render_views(gaussians, capture, some), strict=True)


def row_title(training: str, way: str) -> str:
    """Return a row's title, such as `modal` or `paper-tuned: linear`."""
    return training if training == way else f"{training}: {way}"
