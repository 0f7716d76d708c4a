"""A dataset with some of its training cameras: the same files under another folder."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.bench.errors import BenchError
from tg4mm.bench.sets import BenchSet
from tg4mm.files import write_json
from tg4mm.untrusted import read_json

TRAIN = "transforms_train.json"


def with_views(data: BenchSet, n: int, folder: Path) -> Path:
    """The dataset with `n` training cameras, evenly spread, in `folder`/<its name>; made once.

    Everything else is the same: test cameras, ground truth, points. Raises BenchError where the dataset has fewer
    cameras than that, or is no tree of timesteps.
    """
    if n > data.n_views:
        raise BenchError(f"dataset {data.root} has {data.n_views} training cameras, {n} are asked for")
    target = folder / data.root.name
    if target.is_dir():
        return target
    if not (data.root / "000" / TRAIN).is_file():
        raise BenchError(f"dataset {data.root} has no 000/{TRAIN}: its cameras cannot be thinned out")
    folder.mkdir(parents=True, exist_ok=True)
    making = folder / f".{data.root.name}.tmp"
    shutil.rmtree(making, ignore_errors=True)  # what a killed call has left
    kept = set(np.unique(np.linspace(0, data.n_views - 1, n).round().astype(int)).tolist())
    shutil.copytree(data.root, making, copy_function=_same_file, ignore=shutil.ignore_patterns(TRAIN))
    for source in sorted(data.root.glob(f"*/{TRAIN}")):
        _write_thinned(source, making / source.relative_to(data.root), kept)
    _record(making, len(kept))
    os.replace(making, target)
    return target


def _same_file(source: str, target: str) -> None:
    """A hard link, since a dataset's paths may not leave its folder; a copy where that cannot be."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def _write_thinned(source: Path, target: Path, kept: set[int]) -> None:
    content: dict[str, Any] = read_json(source)
    content["frames"] = [frame for i, frame in enumerate(content["frames"]) if i in kept]
    target.unlink(missing_ok=True)
    write_json(target, content)


def _record(root: Path, n_views: int) -> None:
    file = root / "scene.json"
    scene = read_json(file)
    file.unlink()  # the name only: the original keeps its content
    write_json(file, scene | {"n_train": n_views})
