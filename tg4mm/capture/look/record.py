"""Conversion of a look's result to plain values, for a run's log, and back."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from tg4mm.capture.look.model import FlickerLine, GlobalMotion, LookLine, LookSummary, MovingRegion, Readout


def to_record(found: LookSummary) -> dict[str, Any]:
    """Convert to lists, numbers and texts; grids of cells become the numbers of those that are true."""
    return {
        "lines": [
            asdict(line) | {"cells": _numbers(line.cells), "region": _numbers(line.region)}
            for line in found.lines
        ],
        "movers": [asdict(mover) for mover in found.movers],
        "light": [asdict(tone) for tone in found.light],
        "whole": [asdict(tone) for tone in found.whole],
        "hz": [float(f"{f:.6g}") for f in found.hz],
        "composite": [float(f"{c:.4g}") for c in found.composite],
        "composite_floor": found.composite_floor,
        "moves_by_itself": _numbers(found.moves_by_itself),
        "grid": list(found.moves_by_itself.shape),
        "cell_px": found.cell_px,
        "size": list(found.size),
        "without_between": found.without_between,
        "light_readout": None if found.light_readout is None else asdict(found.light_readout),
        "swings": [asdict(swing) for swing in found.swings],
        "coded_change": found.coded_change,
        "rows_s": found.rows_s,
        "conversion": found.conversion,
    }


def from_record(values: Mapping[str, Any]) -> LookSummary:
    """Convert back from `to_record`."""
    rows, columns = values["grid"]

    def grid(numbers: list[int]) -> np.ndarray:
        out = np.zeros(rows * columns, bool)
        out[numbers] = True
        return out.reshape(rows, columns)

    lines = [
        LookLine(**_tuples(v) | {"cells": grid(v["cells"]), "region": grid(v["region"])})
        for v in values["lines"]
    ]
    return LookSummary(
        lines=tuple(lines),
        movers=tuple(MovingRegion(**_tuples(v)) for v in values["movers"]),
        light=tuple(FlickerLine(**v) for v in values["light"]),
        whole=tuple(FlickerLine(**v) for v in values["whole"]),
        hz=np.array(values["hz"]),
        composite=np.array(values["composite"]),
        composite_floor=values["composite_floor"],
        moves_by_itself=grid(values["moves_by_itself"]),
        cell_px=values["cell_px"],
        size=tuple(values["size"]),
        without_between=values.get("without_between", False),
        light_readout=Readout(**values["light_readout"]) if values.get("light_readout") else None,
        swings=tuple(
            GlobalMotion(**v | {"tones": tuple(FlickerLine(**t) for t in v["tones"])})
            for v in values.get("swings", [])
        ),
        coded_change=values.get("coded_change", 0.0),
        rows_s=values.get("rows_s", 0.0),
        conversion=values.get("conversion", ""),
    )


def _numbers(grid: np.ndarray) -> list[int]:
    return [int(k) for k in np.flatnonzero(grid)]


def _tuples(values: Mapping[str, Any]) -> dict[str, Any]:
    return {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
