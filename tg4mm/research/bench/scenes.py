"""Runs every method on every dataset for the benchmark's tables, resumable by jobs."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.files import to_json
from tg4mm.core.progress import progress
from tg4mm.fit.motion.config import asked_band
from tg4mm.research.bench import BenchError
from tg4mm.research.bench.folder import FORMAT, VERSION, circumstances, open_folder, why_failed
from tg4mm.research.bench.jobs import TableLine, is_finished, job_folder, run_job
from tg4mm.research.bench.means import JUDGED, group_means, less, line_means
from tg4mm.research.bench.measure import alphas_of, check_plan, is_measured, warm_up
from tg4mm.research.bench.methods import Method, Trained
from tg4mm.research.bench.methods.known import DEFAULT, External, methods_of
from tg4mm.research.bench.pages.write import write_page, write_results
from tg4mm.research.bench.request import BenchPlan, Training, check_settings, same_time_training
from tg4mm.research.bench.scored import Checkout, with_closure
from tg4mm.research.bench.sets import BenchSet, group_titles, open_sets, open_those_that_open, torn_truth
from tg4mm.research.evaluate.run import CEILING, STATIC

KIND = "scenes"
SAME_TIME_CHOICES = ("needed", "always", "never")
Printer = Callable[[str], None]


@dataclass(frozen=True)
class ScenesRequest:
    """A request. `same_time`: when `same_time_trainings` trains a `paper` preset again for the time of `modal`."""

    methods: tuple[str, ...] = DEFAULT
    settings: dict[str, dict[str, str]] = field(default_factory=dict)  # by preset, as `--set`
    external: tuple[External, ...] = ()
    same_time: str = "needed"
    plan: BenchPlan = field(default_factory=BenchPlan)
    vqa: tuple[Checkout, ...] = ()
    collect: bool = False  # only make the tables of finished jobs

    def presets(self) -> list[str]:
        """Return the presets of `tg4mm train` among the methods."""
        return [
            m.training.preset for m in self.made() if isinstance(m, Trained) and m.training.trainer is None
        ]

    def made(self) -> list[Method]:
        return methods_of(self.methods, self.settings, self.external)


def run_scenes(
    roots: Sequence[Path],
    out: Path,
    request: ScenesRequest,
    say: Printer = print,
) -> dict[str, Any]:
    """Run unfinished jobs, and write results.json and the pages in `out` after every job.

    Unreadable datasets and failed jobs are listed under `failed` with the reason; the others continue. Raises
    Tg4mmError (BenchError, CaptureError, RunError) on bad options before anything is written, and if nothing succeeds.
    """
    if request.same_time not in SAME_TIME_CHOICES:
        raise Tg4mmError(f"--same-time {request.same_time!r}, expected {', '.join(SAME_TIME_CHOICES)}")
    methods = request.made()
    for preset in request.presets():
        check_settings(request.settings.get(preset, {}), preset)
    sets, failed = open_those_that_open(roots, request.plan.alphas)
    sets = _in_band(sets, request)
    failed += torn_truth(sets, request.plan.alphas)
    check_plan(sets, request.plan)
    open_folder(Path(out), KIND)
    for found in failed:
        say(f"{found['set']}: left out: {found['why']}")
    if not request.collect:
        for line in foreseen(sets, request):
            say(line)
        _prepare(sets, Path(out), out, request, methods, say)
    bench = _Bench(Path(out), request, sets, failed, say)
    jobs = {(d.label, m.name): is_finished(m, d, Path(out), request.plan) for d in sets for m in methods}
    n_done = sum(jobs.values())
    with progress("benchmark", len(jobs), unit="jobs", start=n_done) as update:
        for data in sets:
            for method in methods:
                if not jobs[data.label, method.name]:
                    bench.write()  # finished results can be read while others run
                bench.job(method, data)
                if not jobs[data.label, method.name]:
                    n_done += 1
                    update(n_done)
            for training in same_time_trainings(bench.figures[data.label], request):
                bench.job(Trained(training), data)
                bench.write()
    if not bench.lines and not bench.runs:
        raise bench.first_error or Tg4mmError("nothing was run")
    results = bench.results()
    write_results(Path(out), results)
    write_page(Path(out), results)
    return results


def foreseen(sets: Sequence[BenchSet], request: ScenesRequest) -> Iterator[str]:
    """Yield a line for each outside method that will fail, before hours of training."""
    for data in sets:
        for method in request.external:
            try:
                method.fit(data, Path(), request.plan)
                for alpha in alphas_of(data, request.plan):
                    if method.has(data, alpha):
                        method.check(data, alpha)
            except (Tg4mmError, OSError) as error:
                yield f"{data.label}, {method.name} will fail: {error}"


def run_one(root: Path, name: str, out: Path, request: ScenesRequest) -> Path:
    """Run one method on one dataset for a later `run_scenes`; returns its folder. Raises Tg4mmError."""
    methods = {m.name: m for m in request.made()}
    if name not in methods:
        raise Tg4mmError(f"method {name!r} is none of {', '.join(methods)}")
    (data,) = _in_band(open_sets([root]), request)
    check_plan([data], request.plan)
    open_folder(Path(out), KIND)
    _prepare([data], job_folder(out, data, methods[name]), out, request, [methods[name]], lambda text: None)
    _, lines = run_job(methods[name], data, out, request.plan, request.vqa)
    for why in (why for line in lines for why in line.failed):
        raise BenchError(f"{name} on {data.label}: {why}; the other α are scored")
    return job_folder(out, data, methods[name])


def _band(request: ScenesRequest) -> str:
    """Return `motion.band` if set, which every method then magnifies."""
    return request.settings.get("modal", {}).get("motion.band", "")


def _shown_band(request: ScenesRequest) -> str | None:
    if not request.plan.banded:
        return None
    asked = asked_band(_band(request))
    return (
        f"{asked[0]:g} to {asked[1]:g} Hz" if asked else "the motion's frequencies and 1.5 Hz on either side"
    )


def _in_band(sets: Sequence[BenchSet], request: ScenesRequest) -> list[BenchSet]:
    """Return the sets with the requested band. Raises Tg4mmError for one above half the rate of a set."""
    bands = [asked_band(_band(request), s.fps) or s.band_hz for s in sets]
    return [replace(s, band_hz=band) for s, band in zip(sets, bands, strict=True)]


class _Bench:
    def __init__(
        self,
        out: Path,
        request: ScenesRequest,
        sets: Sequence[BenchSet],
        failed: list[dict[str, str]],
        say: Printer,
    ) -> None:
        self.out, self.request, self.sets, self.failed, self.say = out, request, sets, failed, say
        self.here = circumstances()
        self.runs: list[dict[str, Any]] = []
        self.lines: list[dict[str, Any]] = []
        # set → preset → figures
        self.figures: dict[str, dict[str, dict[str, Any]]] = {s.label: {} for s in sets}
        self.first_error: Exception | None = None
        self.written = 0, 0  # lines and failures in the tables

    def job(self, method: Method, data: BenchSet) -> None:
        """Run one method on one dataset; a failure becomes a line of `failed`."""
        self.say(f"{data.label}, {method.name}")
        plan, collect = self.request.plan, self.request.collect
        try:
            if collect and isinstance(method, Trained):
                self._check_trained(method, data)
            figures, lines = run_job(method, data, self.out, plan, self.request.vqa, collect)
        except Exception as error:  # one job's error must not end hours of others
            self.first_error = self.first_error or error
            why = why_failed(error, job_folder(self.out, data, method))
            self.failed.append({"set": data.label, "method": method.name, "why": why})
            self.say(f"    failed: {why}")
        else:
            self._keep(method, data, figures, lines)

    def write(self) -> None:
        """Write the tables if there are more results than at the last call."""
        now = len(self.lines), len(self.failed)
        if self.lines and now != self.written:
            write_results(self.out, self.results())
            self.written = now

    def _check_trained(self, method: Trained, data: BenchSet) -> None:
        if not is_measured(job_folder(self.out, data, method), data, method.training, self.request.plan):
            raise BenchError(
                f"{method.name} on {data.label} is not finished, or was made with other settings or pictures"
            )

    def _keep(self, method: Method, data: BenchSet, figures: dict[str, Any], lines: list[TableLine]) -> None:
        if isinstance(method, Trained):
            self.figures[data.label][method.training.name] = figures
            self.runs.append(run_entry(data, method.training.name, method.training, figures))
        elif figures:
            entry = {"set": data.label, "row": method.name, "preset": "", "overrides": {}, "ways": []}
            self.runs.append(entry | figures)
        for line in lines:
            for why in line.failed:
                self.failed.append({"set": data.label, "method": line.row, "why": why})
                self.say(f"    failed: {why}")
        self.lines += [{"set": data.label, **to_json(asdict(line), "line")} for line in lines]
        mine = [line for line in self.lines if line["set"] == data.label]
        # At α = 0 both ends are nearly equal, so that closure has no meaning.
        for alpha in {a for line in mine for a in line["alphas"] if float(a) > 0}:
            at = {line["row"]: line["alphas"][alpha] for line in mine if alpha in line["alphas"]}
            with_closure(at, STATIC, CEILING)

    def results(self) -> dict[str, Any]:
        """Return the content of results.json."""
        titles = group_titles(self.sets)
        sets = [s.plain() | {"group": titles[s.label]} for s in self.sets]
        kinds = {s.label: s.cameras for s in self.sets}
        found: dict[str, Any] = {
            "format": FORMAT,
            "version": VERSION,
            "kind": KIND,
            "made": self.here,
            "methods": [m.name for m in self.request.made()],
            "same_time": self.request.same_time,
            "band": _shown_band(self.request),
            "sets": sets,
            "runs": self.runs,
            "lines": self.lines,
            "failed": self.failed,
        }
        scenes = {s.label: s.scene for s in self.sets}
        found["means"] = group_means(self.runs, titles, scenes)
        found["line_means"] = line_means(self.lines, titles, scenes)
        found["kind_means"] = group_means(self.runs, kinds, scenes)
        found["kind_line_means"] = line_means(self.lines, kinds, scenes)
        found["against"] = JUDGED if JUDGED in {line["row"] for line in self.lines} else None
        found["differences"] = line_means(less(self.lines, found["against"] or ""), titles, scenes)
        return found


def _prepare(
    sets: Sequence[BenchSet],
    place: Path,
    out: Path,
    request: ScenesRequest,
    methods: Sequence[Method],
    say: Printer,
) -> None:
    """Compile the kernels of the coming runs, by temporary trainings in `place`."""

    def is_open(m: Trained) -> bool:
        return any(not is_measured(job_folder(out, s, m), s, m.training, request.plan) for s in sets)

    presets = [m.training.preset for m in methods if isinstance(m, Trained) and is_open(m)]
    if presets:
        say("compiling kernels by one iteration of each stage, which is not timed")
    warm_up(place, sets, dict.fromkeys(presets), request.plan.device)


def run_entry(data: BenchSet, row: str, training: Training, figures: dict[str, Any]) -> dict[str, Any]:
    """Return a run's entry in results.json."""
    return {
        "set": data.label,
        "row": row,
        "preset": training.preset,
        "overrides": training.overrides,
        "ways": [way.name for way in training.ways],
        **{k: v for k, v in figures.items() if k not in {"version", "request"}},
    }


def same_time_trainings(figures: dict[str, dict[str, Any]], request: ScenesRequest) -> list[Training]:
    """Return the `paper` presets with iterations scaled to the time of `modal` on this machine.

    "needed": only if the preset took less time than `modal`, so that the comparison favoured `modal`; a slower preset
    had the advantage already.
    """
    if "modal" not in figures or request.same_time == "never":
        return []
    found = []
    for preset in request.presets():
        if preset == "modal" or preset not in figures:
            continue
        factor = figures["modal"]["seconds"]["total"] / max(figures[preset]["seconds"]["total"], 1e-9)
        if request.same_time == "always" or factor > 1.0:
            found.append(same_time_training(preset, request.settings.get(preset, {}), factor))
    return found
