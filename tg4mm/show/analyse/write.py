"""Print an analysis, and write it as JSON, CSV and plots into one folder, by the table of quantities."""

import csv
import re
from collections.abc import Iterable, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core import __version__
from tg4mm.core.digits import aligned
from tg4mm.core.files import to_json, write_atomic, write_json
from tg4mm.core.work_folder import WorkFolder
from tg4mm.show.analyse.channel import AnalyseError
from tg4mm.show.analyse.results import QUANTITIES, Analysis
from tg4mm.show.plotting import pyplot, save

MARK = "analysis.json"


def work_folder(out: Path) -> WorkFolder:
    """Return OUT as the folder of an analysis."""
    return WorkFolder(out, MARK, AnalyseError)


def format_analysis(found: Analysis) -> str:
    """Return the printed tables of the quantities that have results, and the notes."""
    parts = []
    for quantity in QUANTITIES:
        if lines := [line for result in found[quantity.name] for line in quantity.lines(result)]:
            parts.append("".join(f"{line}\n" for line in aligned([quantity.printed, *lines])))
    parts.append("".join(f"note: {note}\n" for note in found.notes))
    return "\n".join(part for part in parts if part)


def write_analysis(found: Analysis, out: Path, plots: bool = True) -> None:
    """Write OUT/analysis.json with everything, a CSV file for each quantity that has rows, and plots if wanted."""
    content = {
        "format": "tg4mm", "kind": "analysis", "version": 1, "program": f"tg4mm {__version__}",
        "averaging": _plain(found.record.averaging), "deviations": "one standard deviation; null: none is stated",
        **_plain(found.results), "notes": list(found.notes),
    }  # fmt: skip
    write_json(out / MARK, to_json(content, MARK))
    for quantity in QUANTITIES:
        if quantity.file:
            rows = [row for result in found[quantity.name] for row in quantity.rows(result)]
            _write_csv(out / quantity.file, quantity.columns, rows)
    if plots:
        _write_plots(found, out / "plots")


def _plain(value: Any) -> Any:
    """Return dictionaries, lists and numbers; complex numbers as size and phase; None for what is not finite."""
    if is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, dict):
        return {name: _plain(own) for name, own in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(v) for v in value]
    if isinstance(value, np.ndarray):
        if np.iscomplexobj(value):
            return {"size": _plain(np.abs(value)), "phase_rad": _plain(np.angle(value))}
        return [_plain(v) for v in value.tolist()]
    if isinstance(value, float):
        return float(f"{value:.6g}") if np.isfinite(value) else None
    return value


def _text(value: Any) -> str:
    if isinstance(value, str):
        return value
    return f"{value:.6g}" if np.isfinite(value) else ""


def _write_csv(path: Path, head: Sequence[str], rows: Sequence[Iterable[Any]]) -> None:
    if not rows:
        path.unlink(missing_ok=True)  # of an earlier analysis
        return

    def write(temporary: Path) -> None:
        with temporary.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows([head, *(map(_text, row) for row in rows)])

    write_atomic(path, write)


def _write_plots(found: Analysis, folder: Path) -> None:
    """Write FOLDER/*.png and remove those of an earlier analysis."""
    made: set[Path] = set()
    folder.mkdir(parents=True, exist_ok=True)
    with pyplot() as plt:
        for quantity in QUANTITIES:
            if quantity.plot is not None:
                for name, figure in quantity.plot(plt, found.record, found[quantity.name]):
                    made.add(path := folder / (re.sub(r"[^\w.-]+", "_", name) + ".png"))
                    save(plt, figure, [path])
    for old in set(folder.glob("*.png")) - made:
        old.unlink()
