"""An analysis: everything that is computed of a record, by the options of `tg4mm analyse`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tg4mm.core.progress import progress
from tg4mm.show.analyse.channel import doubts_of
from tg4mm.show.analyse.record import Record
from tg4mm.show.analyse.results import QUANTITIES
from tg4mm.show.options import AnalyseOptions


@dataclass(frozen=True)
class Analysis:
    """What was computed of a record: the results of each quantity of `results.QUANTITIES` by its name."""

    record: Record
    results: dict[str, tuple[Any, ...]]
    notes: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> tuple[Any, ...]:
        return self.results[name]


def analyse(path: Path, options: AnalyseOptions | None = None) -> Analysis:
    """Compute all quantities of a folder of `tg4mm measure`, a CSV file or a universal file.

    Raises AnalyseError for what cannot be computed of it.
    """
    record, results = Record(path, options or AnalyseOptions()), {}
    with progress("analysis", len(QUANTITIES), "quantities", brief=True) as update:
        for done, quantity in enumerate(QUANTITIES, 1):
            results[quantity.name] = tuple(quantity.compute(record))
            update(done)
    zones = (note for zone in results["zones"] for note in zone.notes)
    notes = [*record.changes[1], *zones, *doubts_of(path)]
    return Analysis(record, results, tuple(dict.fromkeys(notes)))
