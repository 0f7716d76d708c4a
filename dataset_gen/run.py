"""Makes a dataset: prepare, render, finish; on this machine in one go, or part by part on many."""

import shutil
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TextIO

from tg4mm.core.files import remove_leftovers
from tg4mm.core.pictures import png
from tg4mm.core.progress import progress, say
from tg4mm.core.untrusted import read_formed

from . import points, processes, tree
from .effects import codec
from .errors import GenerateError
from .plan import RANGE, UNCODED, Shot, ranges
from .prepare import DatasetJob, claim, placed, plan
from .processes import RunFailed
from .report import write_report
from .settings import Settings

Timing = dict[str, Any]  # pictures, seconds, processes
TIMING = "report/timing.json"  # of all calls that rendered something
PARTS = ".parts"  # working folder of a run in parts: parts.json, and a file for each that is done


def generate(settings: Settings, out: Path, count: int = 0, stream: TextIO | None = None) -> Path:
    """Generates a dataset, or finishes one that a killed run left, and returns its folder.

    Parameters: `out`, the parent folder; `count`, render processes at once (0: one per core); `stream`, where
    progress goes (standard error). Raises GenerateError on bad input and RunFailed if rendering fails.
    """
    stream = stream or sys.stderr
    job = claim(plan(settings, out))
    with tree.work_folder(job.root).locked("makes this dataset"):
        codec.begin(job.root, job.settings)
        path = job.root / TIMING
        former = [_timing(path)] if path.exists() else []

        def note(now: Timing) -> None:  # picture by picture, so that a killed call counts as well
            tree.write_json(path, _total([*former, now]))

        render_missing(job, range(len(job.shots)), count, stream, note)
        return finish(job, stream)


def render_missing(
    job: DatasetJob,
    numbers: Sequence[int],
    count: int,
    stream: TextIO,
    note: Callable[[Timing], None] = lambda timing: None,
) -> Timing:
    """Renders those of the shots with these numbers that are not complete; `note` hears of each picture."""
    todo = [i for i in numbers if not _finished(job, job.shots[i])]
    count = count or processes.cores()
    start = time.monotonic()

    def timing(done: int) -> Timing:
        return {"pictures": done, "seconds": time.monotonic() - start, "processes": count}

    processes.render(job.settings, job.root, todo, count, stream, lambda done: note(timing(done)))
    return timing(len(todo))


def _timing(path: Path) -> Timing:
    """Raises RunFailed for a file that is not what `render_missing` gave."""
    try:
        return read_formed(path, tree.TIMING)
    except ValueError:
        raise RunFailed(f"{path} is not the record of a rendering; remove it") from None


def _total(timings: Sequence[Timing]) -> Timing:
    total = {key: sum(t[key] for t in timings) for key in ("pictures", "seconds")}
    return {**total, "processes": max(t["processes"] for t in timings)}


def finish(job: DatasetJob, stream: TextIO) -> Path:
    """Videos, the check that nothing is missing, points, and the report. Raises RunFailed if something is."""
    codec.finish(job.root, job.settings)
    if missing := missing_files(job):
        raise RunFailed(f"{job.root}: {len(missing)} files are missing or damaged, the first is {missing[0]}")
    if points.wanted(job.root, job.settings):
        _write_points(job)
    if parts := [t for p in (job.root / PARTS).glob("*.done") if (t := _timing(p))["pictures"]]:
        former = [_timing(job.root / TIMING)] if (job.root / TIMING).exists() else []
        tree.write_json(job.root / TIMING, _total([*former, *parts]))
    remove_leftovers(job.root)
    shutil.rmtree(job.root / points.FOLDER, ignore_errors=True)
    shutil.rmtree(job.root / PARTS, ignore_errors=True)
    codec.clean(job.root, job.settings)
    if not (job.root / "report/index.html").exists():
        try:
            write_report(job.root)
        except GenerateError as error:  # a package is missing: inside Blender's own Python they often are
            say("warning", f"no report: {error}", "warning: ", stream)
    return job.root


def prepare_parts(settings: Settings, out: Path, parts: int = 0) -> Path:
    """Prepare a dataset for rendering in parts; `parts.json` in the returned folder holds their number."""
    job = plan(settings, out)
    parts = parts or max(1, -(-len(job.shots) // RANGE))
    if not 1 <= parts <= len(job.shots):
        raise GenerateError(
            f"--parts {parts} is not in 1 … {len(job.shots)}, the number of distinct pictures"
        )
    folder = claim(job).root / PARTS
    tree.write_json(folder / "parts.json", {"parts": parts, "shots": len(job.shots)})
    return folder


def render_part(settings: Settings, out: Path, part: tuple[int, int], count: int, stream: TextIO) -> Path:
    """Renders part I of N (from 1) and returns the file that says it is done."""
    number, parts = part
    job = plan(settings, out)
    if not 1 <= number <= parts <= len(job.shots):
        raise GenerateError(
            f"--part {number}/{parts}: expected I/N with 1 ≤ I ≤ N, and N at most {len(job.shots)}"
        )
    timing = render_missing(claim(job), ranges(len(job.shots), parts)[number - 1], count, stream)
    done = job.root / PARTS / f"{number}_of_{parts}.done"
    tree.write_json(done, timing)
    return done


def finish_parts(settings: Settings, out: Path, stream: TextIO) -> Path:
    """Finish the dataset after all parts are rendered."""
    job = claim(plan(settings, out))
    with tree.work_folder(job.root).locked("makes this dataset"):
        return finish(job, stream)


def missing_files(job: DatasetJob) -> list[str]:
    """Files of the set, relative to its folder, that are absent or not whole."""
    missing = [name for name in _files(job) if not tree.complete(job.root, name, job.settings)]
    if points.wanted(job.root, job.settings):
        views = [points.view_file(job.root, shot) for shot in job.shots if shot.paints]
        missing += [str(path.relative_to(job.root)) for path in views if not path.exists()]
    return missing or _unsound(job)


def _unsound(job: DatasetJob) -> list[str]:
    names = [name for name in _distinct(job) if name.endswith(".png")]
    found = []
    with progress("checking files", len(names), "files", brief=True) as update:
        for done, name in enumerate(names, 1):
            if not png.sound(job.root / name):
                found.append(name)
            update(done)
    return found


def _distinct(job: DatasetJob) -> list[str]:
    seen = {(job.root / name).stat().st_ino: name for name in _files(job)}
    return list(seen.values())


def _files(job: DatasetJob) -> list[str]:
    return [name.removeprefix(f"{UNCODED}/") for shot in job.shots for name in shot.files]


def _finished(job: DatasetJob, shot: Shot) -> bool:
    if (
        points.wanted(job.root, job.settings)
        and shot.paints
        and not points.view_file(job.root, shot).exists()
    ):
        return False
    return all(tree.complete(job.root, name, job.settings) for name in shot.files)


def _write_points(job: DatasetJob) -> None:
    views = []
    for shot in job.shots:
        if shot.paints:
            file = points.view_file(job.root, shot)
            try:
                views.append(points.read_view(file, job.settings.points))
            except ValueError as error:
                raise RunFailed(
                    f"{file} is damaged ({error}); remove it, then run the same command again"
                ) from None
    wanted = job.settings.points
    seen, colours = points.merge(views, wanted)
    if not len(seen):
        raise RunFailed(
            f"{job.root}: no training camera sees any of the scene's surface; --points 0 leaves them out"
        )
    candidates = points.sample_surfaces(job.bodies, wanted, job.settings.seed)
    points.write_ply(job.root / points.FILE, candidates.positions[seen], candidates.normals[seen], colours)


def save_animation(settings: Settings, path: Path) -> Path:
    """Saves the scene with its motion as a .blend that plays."""
    if path.suffix != ".blend":
        raise GenerateError(f"--save-blend {path}: the name should end in .blend")
    if path.exists():
        raise GenerateError(f"--save-blend {path}: the file exists already; remove it or choose another name")
    settings, _, _ = placed(settings)
    path.parent.mkdir(parents=True, exist_ok=True)
    processes.single(
        {"task": "animate", "settings": settings.to_json(), "path": str(path.resolve())}, "saving"
    )
    return path
