"""One job, a method on a dataset: fits, renders test pictures at every α, and scores them; nothing is done twice."""

import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture import Capture
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.files import json_digest
from tg4mm.core.metrics import has_flip
from tg4mm.core.pictures.decode import to_bytes, write_png
from tg4mm.core.progress import progress
from tg4mm.core.untrusted import read_formed, write_sealed
from tg4mm.core.values import Just, Maybe
from tg4mm.research.bench import BenchError
from tg4mm.research.bench.folder import claim_set, files_state, filmed_digest, safe_name
from tg4mm.research.bench.measure import alphas_of, weights_state
from tg4mm.research.bench.methods import Method
from tg4mm.research.bench.methods.known import External
from tg4mm.research.bench.request import BenchPlan
from tg4mm.research.bench.scored import Checkout, cameras_of, picture_name, score_pictures, video_of
from tg4mm.research.bench.sets import BenchSet, truth_at, truth_state
from tg4mm.research.evaluate.lpips import load_lpips

SCORES = "scores.json"
_VERSION = 1  # of the scores; to be raised when the same pictures would have others
_RECORD = {"recipe": str, "n_images": int, "frames_per_s": Maybe(float)}
_SCORES = {"version": Just(_VERSION), "entries": {str: {"asked": str, "scores": {str: Maybe(float)}}}}


@dataclass(frozen=True)
class TableLine:
    """A row of the tables on one dataset."""

    row: str
    method: str
    alphas: dict[str, dict[str, Any]]  # α as text → scores
    frames_per_s: float | None  # posing and rendering, without writing files; median over α > 0
    notes: tuple[str, ...] = ()
    failed: tuple[str, ...] = ()  # reasons for missing α


def job_folder(out: Path, data: BenchSet, method: Method) -> Path:
    """Return the folder of a method's results on a dataset."""
    return Path(out) / "runs" / data.label / method.name


def picture_folder(place: Path, row: str) -> Path:
    """Return the folder of a row's pictures, named as in the dataset: magnified/x020/007/test/r_000.png."""
    return place / "pictures" / safe_name(row)


def run_job(
    method: Method,
    data: BenchSet,
    out: Path,
    plan: BenchPlan,
    vqa: Sequence[Checkout] = (),
    collect: bool = False,
) -> tuple[dict[str, Any], list[TableLine]]:
    """Return the figures of `fit` and the method's rows, computed or read from an earlier call.

    collect: missing α are not computed. An α that fails is left out, with the reason in the row; if all fail, the first
    Tg4mmError is raised.
    """
    place = job_folder(out, data, method)
    if collect and not _Kept(place / SCORES).entries:
        raise BenchError(
            f"{method.name} on {data.label} is not finished, or was made with other settings or pictures"
        )
    claim_set(Path(out), data.label, data.root, data.digest, filmed_digest(data.root))
    figures = method.fit(data, place, plan)
    if isinstance(method, External) and not method.has_pictures(data):
        return figures, []
    return figures, [_line(method, row, data, place, plan, vqa, collect) for row in method.rows]


def is_finished(method: Method, data: BenchSet, out: Path, plan: BenchPlan) -> bool:
    """Return whether all rows have scores at every α, of any settings, to estimate the remaining time."""
    known = _Kept(job_folder(out, data, method) / SCORES).entries
    return all(f"{row} {alpha}" in known for row in method.rows for alpha in _alphas_by(method, data, plan))


def _alphas_by(method: Method, data: BenchSet, plan: BenchPlan) -> list[int]:
    """Return the α of `alphas_of` for which the method has pictures."""
    return [a for a in alphas_of(data, plan) if not isinstance(method, External) or method.has(data, a)]


def _line(
    method: Method,
    row: str,
    data: BenchSet,
    place: Path,
    plan: BenchPlan,
    vqa: Sequence[Checkout],
    collect: bool,
) -> TableLine:
    notes, failed, first = [], [], None
    kept = _Kept(place / SCORES)
    found: dict[str, dict[str, Any]] = {}
    speeds = []
    for alpha in alphas_of(data, plan):
        if isinstance(method, External) and not method.has(data, alpha):
            notes.append(f"{row} has no pictures at α = {alpha}: none in {method.place(data, alpha)}")
            if alpha:
                warnings.warn(f"{data.label}: --external {notes[-1]}", stacklevel=2)
            continue
        try:
            record, scores = _at(method, row, data, place, alpha, plan, vqa, kept, collect)
        except (Tg4mmError, OSError) as error:  # the other α are still valid
            first = first or error
            failed.append(f"α = {alpha}: {error}")
            continue
        if alpha > 0 and record["frames_per_s"]:  # at 0 a method may do nothing
            speeds.append(record["frames_per_s"])
        found[f"{alpha:g}"] = scores
    if first is not None and not found:
        raise first
    speed = None if not speeds or isinstance(method, External) else float(np.median(speeds))
    return TableLine(row, method.name, found, speed, tuple(notes), tuple(failed))


def _at(
    method: Method, row: str, data: BenchSet, place: Path, alpha: int, plan: BenchPlan, vqa: Sequence[Checkout],
    kept: "_Kept", collect: bool,
) -> tuple[dict[str, Any], dict[str, Any]]:  # fmt: skip
    if collect:
        recipe, old = _found(method, row, data, place, alpha, plan)
        known = kept.known(row, alpha, _asked(recipe, data, alpha, plan, vqa))
        if old is None or known is None:
            raise BenchError(
                f"{row} on {data.label} is not finished, or was made with other settings or pictures"
            )
        return old, known
    capture = truth_at(data, alpha)
    record = rendered(method, row, data, place, capture, alpha, plan)
    asked = _asked(record["recipe"], data, alpha, plan, vqa)
    folder = picture_folder(place, row)
    return record, kept.scores(row, alpha, asked, data, capture, folder, plan, vqa)


def rendered(
    method: Method,
    row: str,
    data: BenchSet,
    place: Path,
    capture: Capture,
    alpha: float,
    plan: BenchPlan,
) -> dict[str, Any]:
    """Render missing pictures; returns {recipe, n_images, frames_per_s}, which is written at the end."""
    recipe, old = _found(method, row, data, place, alpha, plan)
    if old is not None:
        return old
    folder = picture_folder(place, row)
    record = _record_of(folder, alpha)
    spent, n = 0.0, 0
    pictures = method.render(row, data, place, capture, alpha, plan)
    with progress(f"{row}, α = {alpha:g}", len(capture), unit="images") as update:
        while True:
            began = time.perf_counter()
            got = next(pictures, None)
            spent += time.perf_counter() - began
            if got is None:
                break
            if not n:  # pictures are of two recipes until the last is written
                record.unlink(missing_ok=True)
            write_png(folder / picture_name(capture, got[0]), got[1])
            n += 1
            update(n)
    made = {"recipe": recipe, "n_images": n, "frames_per_s": n / spent if spent else None}
    write_sealed(record, made)
    return made


def _found(
    method: Method, row: str, data: BenchSet, place: Path, alpha: float, plan: BenchPlan
) -> tuple[str, dict[str, Any] | None]:
    """Return a digest of everything that determines the pictures, and the record of existing ones."""
    recipe = json_digest({"data": data.digest, "alpha": alpha, **method.recipe(row, data, place, plan)})[:20]
    folder, truth = picture_folder(place, row), truth_at(data, alpha)
    old = _read(_record_of(folder, alpha), _RECORD)
    is_same = old is not None and old["recipe"] == recipe
    files = (folder / picture_name(truth, i) for i in range(len(truth)))
    return recipe, old if is_same and all(file.is_file() for file in files) else None


def _record_of(folder: Path, alpha: float) -> Path:
    return folder / f"x{alpha:03g}.json"


def _read(file: Path, form: dict[str, Any]) -> dict[str, Any] | None:
    """Read a file; None if it is missing or damaged, and is to be written again."""
    try:
        return read_formed(file, form)
    except (OSError, ValueError):
        return None


class _Kept:
    def __init__(self, file: Path) -> None:
        self.file = file
        known = _read(file, _SCORES)
        self.entries: dict[str, Any] = {} if known is None else known["entries"]

    def known(self, row: str, alpha: int, asked: str) -> dict[str, Any] | None:
        """Return the scores of a row at α; None if missing or of another request."""
        entry = self.entries.get(f"{row} {alpha}")
        return dict(entry["scores"]) if entry is not None and entry["asked"] == asked else None

    def scores(
        self, row: str, alpha: int, asked: str, data: BenchSet, capture: Capture, folder: Path, plan: BenchPlan,
        vqa: Sequence[Checkout],
    ) -> dict[str, Any]:  # fmt: skip
        """Return the scores of a row at α, computed if missing or of another request."""
        if (known := self.known(row, alpha, asked)) is not None:
            return known
        lpips = load_lpips(plan.lpips_weights) if plan.lpips_weights else None
        scores: dict[str, Any] = score_pictures(capture, folder, lpips, f"{row}, α = {alpha:g}, scores")
        for checkout in vqa:
            videos = (to_bytes(video_of(capture, rows, folder)) for rows in cameras_of(capture))
            scores[checkout.metric] = float(np.mean([checkout(video, data.fps) for video in videos]))
        self.entries[f"{row} {alpha}"] = {"asked": asked, "scores": scores}
        write_sealed(self.file, {"version": _VERSION, "entries": self.entries})
        return scores


def _asked(recipe: str, data: BenchSet, alpha: float, plan: BenchPlan, vqa: Sequence[Checkout]) -> str:
    asked = {
        "recipe": recipe,
        "lpips": weights_state(plan),
        **({} if has_flip() else {"without": ["flip"]}),
        "vqa": [[c.metric, c.python, str(c.folder), files_state([c.program], c.folder)] for c in vqa],
        "truth": truth_state(data, alpha),
    }
    return json_digest(asked)[:20]
