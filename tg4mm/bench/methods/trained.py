"""Gaussians that move: the presets of `tg4mm train`, and the two rows that frame them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.bench.measure import Plan, Scoring, Training, measure
from tg4mm.bench.methods import Pictures
from tg4mm.bench.sets import BenchSet
from tg4mm.capture import Capture
from tg4mm.evaluate.run import CEILING, OURS, STATIC
from tg4mm.evaluate.scores import pose, render_views
from tg4mm.evaluate.subject import Subject, subject_of
from tg4mm.magnify import Magnification, TemporalFilter
from tg4mm.run import Run
from tg4mm.run.model_hash import model_hash

_CAMERAS_AT_ONCE = 8  # pictures held


@dataclass(frozen=True)
class Trained:
    """A preset, magnified in each of its ways. `framing`: also the rows of its Gaussians at rest and moved exactly."""

    training: Training
    framing: bool = False

    @property
    def name(self) -> str:
        return self.training.name.replace(", ", "-").replace(" ", "_").replace("'", "")

    @property
    def rows(self) -> tuple[str, ...]:
        own = tuple(row_title(self.training.name, way.name) for way in self.training.ways)
        return (STATIC, *own, CEILING) if self.framing else own

    def fit(self, data: BenchSet, place: Path, plan: Plan) -> dict[str, Any]:
        return measure(place, data, self.training, plan)

    def recipe(self, row: str, data: BenchSet, place: Path, plan: Plan) -> dict[str, Any]:
        way = self._way(row)
        return {
            "model": model_hash(place / "run"),
            "row": row,
            "method": None if way is None else way.method,
            "filter": None if way is None else way.filter,
            "band_hz": list(data.band_hz) if plan.banded else None,
        }

    def render(
        self, row: str, data: BenchSet, place: Path, capture: Capture, alpha: float, plan: Plan
    ) -> Pictures:
        subject = self._subject(row, data, place, plan)
        (posed,) = [m for m in subject.methods if m.name == (row if self._way(row) is None else OURS)]
        if self._way(row) is not None and plan.banded and posed.posing is None:
            posed = replace(posed, band=data.band_hz)
        for t in np.unique(capture.timesteps).tolist():
            gaussians = pose(subject.gaussians, posed, t, alpha)
            rows = np.flatnonzero(capture.timesteps == t)
            for first in range(0, len(rows), _CAMERAS_AT_ONCE):
                some = rows[first : first + _CAMERAS_AT_ONCE]
                yield from zip(some.tolist(), render_views(gaussians, capture, some), strict=True)

    def _way(self, row: str) -> Scoring | None:
        """How a row is magnified, None for one that frames the others."""
        return next((w for w in self.training.ways if row_title(self.training.name, w.name) == row), None)

    def _subject(self, row: str, data: BenchSet, place: Path, plan: Plan) -> Subject:
        from tg4mm.capture import load_capture

        way = self._way(row) or self.training.ways[0]
        chosen = None if way.filter is None else TemporalFilter(way.filter)
        bands: list[tuple[float, float]] = [data.band_hz] if plan.banded else []
        magnification = Magnification(method=way.method, filter=chosen)
        run, train = Run.open(place / "run"), load_capture(data.root)
        return subject_of(run, train, bands, magnification, {}, plan.device)


def row_title(training: str, way: str) -> str:
    """`modal`, but `paper-tuned: linear`."""
    return training if training == way else f"{training}: {way}"
