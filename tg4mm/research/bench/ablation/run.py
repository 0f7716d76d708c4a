"""Runs one ablation: trains what its rows ask for, resumable row by row, and writes table, page, picture and JSON."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tg4mm.core.errors import RunError, Tg4mmError
from tg4mm.core.files import json_digest
from tg4mm.core.progress import progress
from tg4mm.core.records import write_sealed
from tg4mm.research.bench import BenchError, StepError
from tg4mm.research.bench.ablation import sets as changed
from tg4mm.research.bench.ablation.catalogue import (
    Ablation,
    Row,
    chosen_preset,
    filter_figures,
    find_ablation,
    rows_of,
)
from tg4mm.research.bench.ablation.page import FILE, ablation_cells, ablation_page, picture
from tg4mm.research.bench.folder import (
    FORMAT,
    VERSION,
    circumstances,
    claim_set,
    filmed_digest,
    open_folder,
    safe_name,
    why_failed,
    write_text,
)
from tg4mm.research.bench.means import scalars
from tg4mm.research.bench.measure import OF_RUN, check_plan, is_measured, measure, warm_up
from tg4mm.research.bench.pages.shown import slices_picture
from tg4mm.research.bench.request import SCORINGS, Plan, Scoring, Training, check_settings, settings_by_preset
from tg4mm.research.bench.sets import BenchSet, open_set, open_those_that_open, torn_truth
from tg4mm.research.text import latex_table

Printer = Callable[[str], None]
_METRICS = ("ssim", "psnr_db")  # PSNR for the column at α = 0


@dataclass(frozen=True)
class _Job:
    data: BenchSet
    rows: tuple[Row, ...]
    training: Training


def run_ablation(
    name: str,
    roots: Sequence[Path],
    out: Path,
    preset: str | None,
    given: Mapping[str, str],
    plan: Plan,
    say: Printer = print,
) -> dict[str, Any]:
    """Run what is not finished of the ablation `name`; returns what results.json holds.

    Writes OUT/results.json, results.md, results.svg and tables/<name>.tex, anew after every training. A row that the
    data do not allow (no points3d.ply, too few cameras) stands under `left_out` with the reason; a dataset without any
    row, and an error that is not the data's, under `failed`. Raises Tg4mmError on bad input, and where no row is
    possible.
    """
    ablation, preset, out = find_ablation(name), chosen_preset(name, preset), Path(out)
    plan = replace(plan, metrics=(*_METRICS, *(("lpips",) if plan.lpips_weights else ())))
    rows = rows_of(name, preset, settings_by_preset(given, [preset])[preset])
    sets, failed = open_those_that_open(roots, plan.alphas)
    failed += torn_truth(sets, plan.alphas)
    _check(rows, preset, sets, plan)
    sets = _renderable(sets, failed) if any(row.is_rendered for row in rows) else sets
    open_folder(out, f"ablation {name}, {preset}")
    results = _results(name, ablation, preset, rows, sets) | {"failed": failed}
    runner = _Runner(preset, plan, out, results, say)
    with progress(f"ablation {name}", len(sets) * len(rows), unit="rows") as update:
        for data in sets:
            runner.run(data, rows, update)
    if not results["lines"]:
        raise runner.first_error or Tg4mmError("nothing was run")
    if ablation.slices:
        known = {line["set"] for line in results["lines"]}
        results["slices"] = _slices(results, rows, next(s for s in sets if s.label in known), out)
        _write(out, results)
    return results


def _check(rows: Sequence[Row], preset: str, sets: Sequence[BenchSet], plan: Plan) -> None:
    """Raise Tg4mmError for what can be known to fail before anything is written."""
    for row in rows:
        check_settings(row.settings, preset)
    check_plan(sets, plan)
    if plan.alphas is not None and any(row.amplitude_px for row in rows):
        given = ",".join(f"{a:g}" for a in plan.alphas)
        raise BenchError(
            f"--alphas {given}: the ablation amplitude chooses α itself, for 1 to 8 pixels of magnified motion"
        )


def _renderable(sets: Sequence[BenchSet], failed: list[dict[str, str]]) -> list[BenchSet]:
    """The sets that can be rendered again; the others go to `failed`. Raises BenchError if none can."""
    found, first = [], None
    for data in sets:
        try:
            changed.generator_arguments(data, {}, data.root)
            found.append(data)
        except BenchError as error:
            first = first or error
            failed.append({"set": data.label, "method": "", "why": str(error)})
    if first is not None and not found:
        raise first
    return found


def _slices(results: dict[str, Any], rows: Sequence[Row], data: BenchSet, out: Path) -> str:
    lines = {line["row"]: line for line in results["lines"] if line["set"] == data.label}
    band = next(iter(lines.values()))["band_hz"]
    shown = {}
    for row in (r for r in rows if r.label in lines):
        run = out / lines[row.label]["run"]
        for way in row.scorings or SCORINGS[results["preset"]]:
            label = row.label if row.scorings else f"{row.label}, {way.name}"
            shown[label] = run, way.magnified([] if band is None else [tuple(band)])
    if not shown:
        return ""
    return f"{data.label}. " + slices_picture(data.root, data.alphas, shown, out / "slices.png")


def _results(
    name: str, ablation: Ablation, preset: str, rows: Sequence[Row], sets: Sequence[BenchSet]
) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "version": VERSION,
        "kind": "ablation",
        "name": name,
        "made": circumstances(),
        "preset": preset,
        **{k: getattr(ablation, k) for k in ("title", "source", "remark", "x_label")},
        "columns": list(ablation.columns),
        "picture": ablation.picture,
        "rows": [row.label for row in rows],
        "ticks": [row.tick or row.label for row in rows],
        "curves": [row.curve for row in rows],
        "apart": [row.apart for row in rows],
        "sets": [s.plain() for s in sets],
        "lines": [],
        "left_out": [],
    }


class _Runner:
    def __init__(self, preset: str, plan: Plan, out: Path, results: dict[str, Any], say: Printer) -> None:
        self.preset, self.plan, self.out, self.results, self.say = preset, plan, out, results, say
        self.is_warm, self.n_done = False, 0
        self.first_error: Exception | None = None

    def run(self, data: BenchSet, rows: Sequence[Row], update: Any) -> None:
        """All rows on one dataset."""
        donor: Path | None = None
        left: list[dict[str, str]] = []
        for group in _groups(rows):
            self.say(f"{data.label}: {', '.join(row.label for row in group)}")
            try:
                claim_set(self.out, data.label, data.root, data.digest, filmed_digest(data.root))
                job = _job(data, group, self.preset, self.plan, self.out)
                place = self.out / "runs" / data.label / _place_name(job, data)
                same_data = job.data is data
                figures = self._measured(place, job, donor if same_data else None)
            except Exception as error:  # one row's fault is not to take hours of others along
                self.first_error = self.first_error or error
                why = why_failed(error, self.out / "runs" / data.label)
                self.say(f"    failed: {why}")
                of_data = isinstance(error, Tg4mmError) and not isinstance(error, RunError | StepError)
                kept = left if of_data else self.results["failed"]
                kept += [{"set": data.label, "method": row.label, "why": why} for row in group]
            else:
                donor = donor or (place / "run" if same_data else None)
                run = str((place / "run").relative_to(self.out))
                self.results["lines"] += [_line(job, data, row, figures) | {"run": run} for row in group]
            _write(self.out, self.results)
            self.n_done += len(group)
            update(self.n_done)
        if any(line["set"] == data.label for line in self.results["lines"]):
            self.results["left_out"] += left
        elif left:
            self.results["failed"].append({"set": data.label, "method": "", "why": left[0]["why"]})
        _write(self.out, self.results)

    def _measured(self, place: Path, job: _Job, donor: Path | None) -> dict[str, Any]:
        # Sets of another amplitude have ground truth at α of their own.
        plan = replace(self.plan, alphas=None) if job.rows[0].amplitude_px else self.plan
        if not self.is_warm and not is_measured(place, job.data, job.training, plan):
            warm_up(self.out, [job.data], [self.preset], plan.device)
            self.is_warm = True
        return measure(place, job.data, job.training, plan, donor)


def _groups(rows: Sequence[Row]) -> list[tuple[Row, ...]]:
    found: dict[str, list[Row]] = {}
    for row in rows:
        key = json.dumps([dict(row.settings), *row.changed_data], sort_keys=True)
        found.setdefault(key, []).append(row)
    return [tuple(group) for group in found.values()]


def _job(data: BenchSet, group: tuple[Row, ...], preset: str, plan: Plan, out: Path) -> _Job:
    row = group[0]
    ways = tuple(Scoring(r.label, s.method, s.filter) for r in group for s in r.scorings)
    training = Training(row.label, preset, row.settings, ways)
    if row.views and row.views != data.n_views:
        root = changed.with_views(data, row.views, out / "sets" / data.label / f"views_{row.views:03d}")
        return _Job(open_set(root, data.label), group, training)
    if row.noise or row.timesteps:
        own, name = data, f"noise_{row.noise:g}"
        if row.noise:
            own = open_set(changed.with_noise(data, row.noise, out / "sets" / data.label / name), data.label)
        if row.timesteps and row.timesteps != data.n_timesteps:
            folder = out / "sets" / data.label / f"{name}_timesteps_{row.timesteps:03d}"
            own = open_set(changed.with_timesteps(own, row.timesteps, folder), data.label)
        return _Job(own, group, training)
    if row.amplitude_px:
        root = changed.with_amplitude(
            data, row.amplitude_px, out / "sets" / data.label / f"px_{row.amplitude_px:g}"
        )
        return _Job(open_set(root, data.label), group, training)
    if row.kind and not row.kind == data.cameras == "orbit":  # that is the reference as it is
        root = changed.with_kind(data, row.kind, plan.alphas, out / "sets" / data.label / f"kind_{row.kind}")
        return _Job(open_set(root, data.label), group, training)
    return _Job(data, group, training)


def _place_name(job: _Job, data: BenchSet) -> str:
    """A folder's name: what is varied, and a digest, since a run belongs to its settings."""
    row = job.rows[0]
    key = [job.training.preset, dict(job.training.settings), *row.changed_data, data.digest]
    digest = json_digest(key)[:8]
    return f"{safe_name(row.label)}_{digest}"


def _line(job: _Job, data: BenchSet, row: Row, figures: dict[str, Any]) -> dict[str, Any]:
    ways = [row.label] if row.scorings else [way.name for way in job.training.ways]
    log = figures["log"]
    values: dict[str, Any] = scalars(figures)
    values["init"] = log.get("space", {}).get("init")
    rest = figures["rows"].get("0", {})
    values["psnr_rest"] = (rest.get("ceiling") or rest.get("nothing moves") or {}).get("psnr_db")
    if row.scorings and figures["request"]["band_hz"]:
        values |= filter_figures(row.scorings[0].filter, data)
    return {
        "set": data.label,
        "row": row.label,
        "ways": ways,
        "settings": figures["request"]["settings"],
        "overrides": dict(job.training.settings),
        "amplitude_px": job.data.amplitude_px,
        "n_views": job.data.n_views,
        "band_hz": figures["request"]["band_hz"],
        "scalars": values,
        "ssim_columns": _columns(row, figures),
        **{k: figures[k] for name in OF_RUN if (k := name.removesuffix("?")) in figures},
    }


def _columns(row: Row, figures: dict[str, Any]) -> dict[str, str]:
    """{a column's title: the α in it}: α itself, or for other amplitudes the motion that it adds, α times them."""
    alphas = [a for a in figures["rows"] if float(a) > 0]
    if not row.amplitude_px:
        return {f"α = {a}": a for a in alphas}
    made = {
        str(round(target / row.amplitude_px)): f"+{target:g} px" for target in reversed(changed.TARGETS_PX)
    }
    return {made[a]: a for a in alphas if a in made}


def _write(out: Path, results: dict[str, Any]) -> None:
    write_sealed(out / FILE, results)
    drawn = picture(results)
    if drawn is not None:
        write_text(out / "results.svg", drawn)
    write_text(out / "results.md", ablation_page(results, drawn is not None))
    made = ablation_cells(results)
    write_text(out / "tables" / f"{made.key}.tex", latex_table(made))
