"""results.json of an ablation, read back for the benchmark's page: of the form that `run_ablation` writes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tg4mm.core.records import read_formed
from tg4mm.core.values import Just, Maybe
from tg4mm.research.bench.ablation.page import COLUMNS, SSIM
from tg4mm.research.bench.errors import BenchError
from tg4mm.research.bench.folder import CIRCUMSTANCES, FORMAT, VERSION
from tg4mm.research.bench.measure import OF_RUN

FILE = "results.json"
_LINE = {
    **OF_RUN,
    "set": str,
    "row": str,
    "ways": [str],
    "overrides": {str: str},
    "scalars": {"init?": Maybe(str), str: Maybe(float)},
    "ssim_columns": {str: str},
}
FORM = {
    "format": Just(FORMAT),
    "version": Just(VERSION),
    "kind": Just("ablation"),
    **dict.fromkeys(("name", "title", "source", "preset", "remark", "x_label", "picture"), str),
    **{key: [str] for key in ("columns", "rows", "ticks", "curves")},
    "apart": [bool],
    "sets": [{"label": str}],
    "lines": [_LINE],
    **{key: [dict.fromkeys(("set", "method", "why"), str)] for key in ("left_out", "failed")},
    "slices?": str,
    "made": CIRCUMSTANCES,
}


def read_ablation(folder: Path) -> dict[str, Any]:
    """results.json of an ablation. Raises BenchError for what is not there, damaged, or not of this version."""
    file = Path(folder) / FILE
    try:
        found = read_formed(file, FORM)
        _check_names(found)
    except OSError as error:
        raise BenchError(f"{file}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise BenchError(f"{file}: {error}; run the ablation's command again") from None
    return found


def _check_names(found: dict[str, Any]) -> None:
    """Raises ValueError where a name stands for nothing."""
    if unknown := [c for c in found["columns"] if c not in COLUMNS]:
        raise ValueError(f"column {unknown[0][:60]!r} is unknown")
    if found["picture"] not in {SSIM, *COLUMNS}:
        raise ValueError(f"picture is {found['picture'][:60]!r}, which is no figure")
    if len({len(found[key]) for key in ("rows", "ticks", "curves", "apart")}) > 1:
        raise ValueError("rows, ticks, curves and apart differ in number")
    if len({curve for curve in found["curves"] if curve}) > 1:
        _check_numbers(found["ticks"], "× ", "", "tick")
    for line in found["lines"]:
        _check_numbers(list(line["ssim_columns"]), "α = ", " px", "column")
        if unknown := [a for a in line["ssim_columns"].values() if a not in line["rows"]]:
            raise ValueError(f"α = {unknown[0][:60]} has no scores")


def _check_numbers(titles: list[str], before: str, after: str, what: str) -> None:
    for title in titles:
        try:
            float(title.replace(before, "").replace(after, "") if after else title.removeprefix(before))
        except ValueError:
            raise ValueError(f"{what} {title[:60]!r} holds no number") from None
