"""Makes a dataset: prepare, render, finish; on this machine in one go, or part by part on many."""

from __future__ import annotations

import os
import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO

import numpy as np

from . import points, processes, tree
from .errors import GenerateError
from .plan import RANGE, Shot, ranges
from .prepare import Job, prepare
from .processes import RunFailed
from .report import write_overview, write_report
from .settings import Settings

PARTS = ".parts"  # working folder of a run in parts: parts.json, and a file for each that is done


def generate(settings: Settings, out: Path, count: int = 0, stream: TextIO | None = None) -> Path:
    """Generates a dataset, or finishes one that a killed run left, and returns its folder.

    Parameters: `out`, the parent folder; `count`, render processes at once (0: one per core); `stream`, where
    progress goes (standard error). Raises GenerateError on bad input and RunFailed if rendering fails.
    """
    stream = stream or sys.stderr
    job = prepare(settings, out)
    tree.clean(job.root)
    render_missing(job, range(len(job.shots)), count, stream)
    return finish(job, stream)


def render_missing(job: Job, numbers: Sequence[int], count: int, stream: TextIO) -> None:
    """Renders those of the shots with these numbers that are not complete."""
    wants_points = _wants_points(job)
    todo = [i for i in numbers if not _finished(job, job.shots[i], wants_points)]
    count = count or (os.cpu_count() or 1)
    start = time.monotonic()
    processes.render(job.settings, job.root, todo, count, stream)
    if todo:
        took = {"pictures": len(todo), "seconds": time.monotonic() - start, "processes": count}
        tree.write_json(job.root / "report/timing.json", took)


def finish(job: Job, stream: TextIO) -> Path:
    """Points, the check that nothing is missing, and the report. Raises RunFailed if something is."""
    if _wants_points(job):
        _write_points(job)
    if missing := missing_files(job):
        raise RunFailed(f"{job.root}: {len(missing)} files are missing or damaged, the first is {missing[0]}")
    shutil.rmtree(job.root / points.FOLDER, ignore_errors=True)
    shutil.rmtree(job.root / PARTS, ignore_errors=True)
    if not (job.root / "report/index.html").exists():
        try:
            write_report(job.root)
        except GenerateError as error:  # a package is missing: inside Blender's own Python they often are
            print(f"warning: no report: {error}", file=stream)
    return job.root


def prepare_parts(settings: Settings, out: Path, parts: int = 0) -> Path:
    """Prepares a dataset to be rendered in parts; `parts.json` in the returned folder tells how many."""
    job = prepare(settings, out)
    parts = parts or max(1, -(-len(job.shots) // RANGE))
    if not 1 <= parts <= len(job.shots):
        raise GenerateError(
            f"--parts {parts} is not in 1 … {len(job.shots)}, the number of distinct pictures"
        )
    folder = job.root / PARTS
    tree.write_json(folder / "parts.json", {"parts": parts, "shots": len(job.shots)})
    return folder


def render_part(settings: Settings, out: Path, part: tuple[int, int], count: int, stream: TextIO) -> Path:
    """Renders part I of N (from 1) and returns the file that says it is done."""
    number, parts = part
    job = prepare(settings, out)
    if not 1 <= number <= parts <= len(job.shots):
        raise GenerateError(f"--part {number}/{parts} is not one of 1 … {len(job.shots)} parts")
    render_missing(job, ranges(len(job.shots), parts)[number - 1], count, stream)
    done = job.root / PARTS / f"{number}_of_{parts}.done"
    tree.write_bytes(done, b"")
    return done


def finish_parts(settings: Settings, out: Path, stream: TextIO) -> Path:
    """What is left when all parts are rendered."""
    return finish(prepare(settings, out), stream)


def missing_files(job: Job) -> list[str]:
    """Files of the set, relative to its folder, that are absent or not whole."""
    names = [name for shot in job.shots for name in shot.files]
    missing = [name for name in names if not tree.complete(job.root, name, job.settings)]
    others = ["truth/motion.npz", *(["points3d.ply"] if job.settings.points else [])]
    return missing + [name for name in others if not (job.root / name).exists()]


def _wants_points(job: Job) -> bool:
    return job.settings.points > 0 and not (job.root / "points3d.ply").exists()


def _finished(job: Job, shot: Shot, wants_points: bool) -> bool:
    if wants_points and shot.paints and not points.view_file(job.root, shot).exists():
        return False
    return all(tree.complete(job.root, name, job.settings) for name in shot.files)


def _write_points(job: Job) -> None:
    views = []
    for shot in job.shots:
        if shot.paints and (path := points.view_file(job.root, shot)).exists():
            with np.load(path, allow_pickle=False) as data:
                views.append({name: data[name] for name in data.files})
    wanted = job.settings.points
    seen, colours = points.merge(views, wanted)
    candidates = points.sample_surfaces(job.bodies, wanted, job.settings.seed)
    points.write_ply(job.root / "points3d.ply", candidates.positions[seen], candidates.normals[seen], colours)


def save_animation(settings: Settings, path: Path) -> Path:
    """Saves the scene with its motion as a .blend that plays."""
    if path.suffix != ".blend":
        raise GenerateError(f"--save-blend {path}: the name should end in .blend")
    path.parent.mkdir(parents=True, exist_ok=True)
    task = {"task": "animate", "settings": settings.to_json(), "path": str(path.resolve())}
    processes.single(task)
    return path


def overview(out: Path) -> Path:
    """The page that shows all sets of a folder side by side."""
    return write_overview(out)
