"""The benchmark's tables as data, from results.json, for Markdown, LaTeX and HTML."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from tg4mm.research.bench.means import mean, scalars
from tg4mm.research.bench.scored import METRICS
from tg4mm.research.evaluate.run import CEILING, STATIC
from tg4mm.research.text import NOTHING, TextTable, shown

Results = Mapping[str, Any]
Columns = Sequence[tuple[str, str, str]]  # key, title, format
# Picture metrics with a table each, methods down and α across.
PIVOTS = (
    "ssim", "closure", "gain", "residual", "ssim_moving", "ssim_gap", "psnr_moving_db", "flip", "lpips", "md_vqa",
    "fast_vqa",
)  # fmt: skip
_SAYS = {
    "ssim": "SSIM of complete pictures over white, as [TG4MM] Table I. Most of a picture is static, so that a still "
    "picture scores high.",
    "ssim_gap": "SSIM of the exact motion of the same Gaussians less that of the method: the loss by motion alone.",
    "closure": "SSIM on a scale from “nothing moves” (0) to the exact motion of the same Gaussians (1). Outside of 0 "
    "to 1: worse than a still picture, or sharper than the Gaussians. It means little if the two ends are close.",
    "gain": "The pictures' change over time, regressed on the ground truth's: 1 is the complete motion, 0 none.",
    "residual": "The part of the pictures' change over time that is not the ground truth's, relative to that; lower is "
    "better. A still picture also has 0, so read it with the gain.",
    "ssim_moving": "SSIM over moving pixels, whose ground truth differs from its mean over time by more than 8/255.",
    "psnr_moving_db": "PSNR over the same pixels, of the mean over all pictures of their mean squared error there.",
    "flip": "Mean FLIP error of complete pictures, lower is better.",
    "lpips": "LPIPS (AlexNet) of complete pictures, lower is better.",
    "md_vqa": "MD-VQA of the magnified videos, without a reference, higher is better.",
    "fast_vqa": "FAST-VQA of the magnified videos, without a reference, higher is better.",
}
_MOTION = (
    ("displacement_error", "error", "{:.1%}"),
    ("displacement_error_observed", "error, observed", "{:.1%}"),
    ("observed_share", "observed", "{:.0%}"),
    ("static_leak", "leak", "{:.1%}"),
    ("amplitude_ratio", "amplitude ratio", "{:.3f}"),
    ("direction_error_deg", "direction, °", "{:.1f}"),
    ("phase_error_deg", "phase, °", "{:+.1f}"),
    ("mac", "MAC", "{:.3f}"),
)
_BY_KIND = (*_MOTION[:2], *_MOTION[3:6], ("frequency_error_hz", "frequency, Hz", "{:.3f}"))
_COSTS = (
    ("space_s", "space, s", "{:.0f}"),
    ("motion_s", "motion, s", "{:.0f}"),
    ("total_s", "both, s", "{:.0f}"),
    ("space_iterations", "space, iterations", "{:,.0f}"),
    ("motion_iterations", "motion, iterations", "{:,.0f}"),
    ("space_peak_mib", "space, peak MiB", "{:.0f}"),
    ("motion_peak_mib", "motion, peak MiB", "{:.0f}"),
    ("n_gaussians", "Gaussians", "{:,.0f}"),
    ("mib_on_disk", "on disk, MiB", "{:.1f}"),
)
_MODES = (
    ("amplitude_ratio", "amplitude ratio", "{:.3f}"),
    ("relative_error", "error", "{:.1%}"),
    ("direction_error_deg", "direction, °", "{:.1f}"),
    ("phase_error_deg", "phase, °", "{:+.1f}"),
    ("static_leak", "leak", "{:.1%}"),
    ("mac", "MAC", "{:.3f}"),
)
_SEEN = tuple((key, title, "{:.2f}") for key, title in (
    ("closure", "closure"), ("change_gain", "gain"), ("change_residual", "residual"),
))  # fmt: skip
_COMPARED = ("ssim", "ssim_moving")


def _titles(columns: Columns) -> list[str]:
    return [title for _, title, _ in columns]


def _cells(values: Mapping[str, Any], columns: Columns) -> list[str]:
    return [shown(values.get(key), form) for key, _, form in columns]


def _scores(keys: Iterable[str]) -> Columns:
    return [(key, *METRICS[key]) for key in keys]


def labels_in(results: Results, group: str) -> list[str]:
    """Return the labels of a group's sets."""
    return [s["label"] for s in results["sets"] if s["group"] == group]


def groups_of(results: Results) -> list[str]:
    """Return the groups of sets with the same size, kind of capture and amplitude, which are averaged."""
    return list(dict.fromkeys(m["group"] for m in (*results["line_means"], *results["means"])))


def tables_of(results: Results, group: str) -> list[TextTable]:
    """Return the tables of a group that are not empty: means by α, motion, modes, cost."""
    found = [
        *pivots(results["line_means"], group),
        *differences_tables(results, group),
        motion_table(results, group),
        own_ceiling_table(results, group),
        modes_table(results, group),
        cost_table(results, group),
    ]
    return [t for t in found if t.rows]


def pivots(means: Sequence[Mapping[str, Any]], group: str) -> Iterator[TextTable]:
    """Yield a table of means for each measured metric: a row for each method, a column for each α."""
    mine = _framed([m for m in means if m["group"] == group])
    alphas = sorted({a for m in mine for a in m["alphas"]}, key=float)
    every = sets_in(mine)
    for key in PIVOTS:
        title, form = METRICS[key]
        known = [a for a in alphas if any(m["alphas"].get(a, {}).get(key) is not None for m in mine)]
        rows = [
            [row_name(m, every), *(_cell(m, a, key, form) for a in known)]
            for m in mine
            if any(key in m["alphas"].get(a, {}) for a in known)
        ]
        if rows:
            yield TextTable(key, title, _SAYS[key], ["method", *(f"α = {a}" for a in known)], rows)


def _cell(means: Mapping[str, Any], alpha: str, key: str, form: str) -> str:
    values, halves = (means[part].get(alpha, {}).get(key) for part in ("alphas", "half"))
    return with_half(values, halves, form)


def with_half(value: float | None, half: float | None, form: str) -> str:
    """Return `0.9671 ± 0.0123`, or the mean without its interval."""
    mean_shown = shown(value, form)
    return (
        mean_shown
        if value is None or half is None
        else f"{mean_shown} ± {form.replace('+', '').format(half)}"
    )


def differences_tables(results: Results, group: str) -> Iterator[TextTable]:
    """Yield each method's difference from one of them on the same sets, which excludes the scatter of scenes."""
    mine = [m for m in results["differences"] if m["group"] == group and m["row"] not in {STATIC, CEILING}]
    alphas = sorted({a for m in mine for a in m["alphas"] if float(a) > 0}, key=float)
    every = sets_in(mine)
    for key in _COMPARED:
        rows = [[row_name(m, every), *(_cell(m, a, key, "{:+.4f}") for a in alphas)] for m in mine]
        title = f"{METRICS[key][0]}, less that of {results['against']}"
        note = "Mean of the differences on each set; below 0 where the method scores lower."
        if alphas and any(NOTHING not in cell for row in rows for cell in row[1:]):
            yield TextTable(f"less_{key}", title, note, ["method", *(f"α = {a}" for a in alphas)], rows)


def sets_in(means: Iterable[Mapping[str, Any]]) -> set[str]:
    """Return all sets in any of the means."""
    return {label for m in means for label in m["sets"]}


def row_name(means: Mapping[str, Any], every: set[str]) -> str:
    """Return the row's name, with a remark if not `every` set is in the means."""
    fewer = set(means["sets"]) != every
    return f"{means['row']} ({means['n_sets']} of {len(every)} sets)" if fewer else str(means["row"])


def _framed(means: list[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    return sorted(means, key=lambda m: (m["row"] == CEILING) - (m["row"] == STATIC))


def full_table(results: Results, group: str) -> TextTable:
    """Return every score: a line per set, α and method."""
    members = labels_in(results, group)
    lines = [line for line in results["lines"] if line["set"] in members]
    keys = [k for k in METRICS if any(s.get(k) is not None for x in lines for s in x["alphas"].values())]
    columns = _scores(keys)
    rows = [
        [line["set"], line["row"], a, *_cells(scores, columns)]
        for line in lines
        for a, scores in line["alphas"].items()
    ]
    header = ["set", "method", "α", *_titles(columns)]
    return TextTable("all", "Every set", "Every score, by set, method and α.", header, rows, 2)


def motion_table(results: Results, group: str) -> TextTable:
    """Compare the Gaussians' motion with the truth, for methods with a motion."""
    note = (
        "Motion of the Gaussians against the exact one, weighted by visibility. Error: rms of the difference by the "
        "rms of the truth; “observed”: over Gaussians with their true motion visible in the pictures, and their share. "
        "Leak: estimated motion of static parts. Amplitude, direction, phase and MAC: of the strongest mode."
    )
    header = ["set", "method", *_titles(_MOTION)]
    return TextTable("motion", "Motion", note, header, _scalar_rows(results, group, _MOTION), 2)


def own_ceiling_table(results: Results, group: str) -> TextTable:
    """Return closure, gain and residual by the ceiling of each method's Gaussians."""
    rows = []
    for run in _runs(results, group):
        for way in run["ways"]:
            for alpha in sorted((a for a in run["rows"] if float(a) > 0), key=float):
                values = run["rows"][alpha].get(way, {})
                title = run["row"] if way == run["row"] else f"{run['row']}: {way}"
                rows.append([run["set"], title, alpha, *_cells(values, _SEEN)])
    note = (
        "Against the exact motion of the same Gaussians, so that their errors at rest do not count: closure"
        " of SSIM; gain and residual of the pictures' change from rest on the ceiling's."
    )
    header = ["set", "method", "α", *_titles(_SEEN)]
    return TextTable("own_ceiling", "Against its own ceiling", note, header, rows, 2)


def modes_table(results: Results, group: str) -> TextTable:
    """Compare each method with each mode of the truth."""
    rows = [
        [run["set"], run["row"], f"{mode['frequency_hz']:g}", *_cells(mode, _MODES)]
        for run in _runs(results, group)
        for mode in (run["displacement"] or {}).get("per_frequency") or []
    ]
    header = ["set", "method", "Hz", *_titles(_MODES)]
    note = (
        "Each frequency of the exact motion. Leak: estimated motion of parts that are static at it. MAC: modal "
        "assurance criterion, 1 if the shapes agree."
    )
    return TextTable("modes", "Modes", note, header, rows, 2)


def cost_table(results: Results, group: str) -> TextTable:
    """Return seconds of each stage, memory, size and rendering speed ([TG4MM] Table II and Fig. 6)."""
    note = (
        "Seconds and iterations of training, most memory held in each stage, Gaussians, size of the model's files; "
        "pictures a second: posing and rendering of the test pictures, without opening the model and writing them, the "
        "mean of linear and phase for a paper preset; for a 2D method, which has no model, it includes reading the "
        "test views. An iteration is a step on one view; in the motion of modal it is one of conjugate gradients on "
        "all views, and the number is the largest that is allowed."
    )
    speeds = {(x["set"], x["row"]): x["frames_per_s"] for x in results["lines"]}
    rows = [row for row in _scalar_rows(results, group, _COSTS) if {*row[2:]} != {NOTHING}]
    members = labels_in(results, group)
    for row in rows:
        of = [row[0]] if row[0] in members else members  # a row of means
        mine = [v for (label, name), v in speeds.items() if label in of and name.split(":")[0] == row[1]]
        row.append(shown(mean(mine), "{:.0f}"))
    known = {(row[0], row[1]) for row in rows}
    for (label, name), speed in speeds.items():
        base = name.split(":")[0]
        if label in members and name not in {STATIC, CEILING} and (label, base) not in known and speed:
            rows.append([label, name, *[NOTHING] * len(_COSTS), f"{speed:.0f}"])
    header = ["set", "method", *_titles(_COSTS), "pictures/s"]
    return TextTable("cost", "Cost", note, header, rows, 2)


def kinds_tables(results: Results) -> list[TextTable]:
    """Return means by the kind of capture, for motion and pictures; none for a single kind."""
    found = [_motion_by_kind(results), _pictures_by_kind(results)]
    several = len({m["group"] for m in results["kind_line_means"]}) > 1
    return [table for table in found if several and table.rows]


def _motion_by_kind(results: Results) -> TextTable:
    rows = [
        [m["group"], m["row"], str(m["n_sets"]), *_cells(m["scalars"], _BY_KIND)]
        for m in results["kind_means"]
    ]
    header = ["kind of capture", "method", "sets", *_titles(_BY_KIND)]
    note = (
        "Means over the sets of one kind of capture. Columns as in the table Motion; frequency: error of the strongest "
        "found mode's."
    )
    return TextTable("kinds_motion", "Motion by kind of capture", note, header, rows, 2)


def _pictures_by_kind(results: Results) -> TextTable:
    columns = _scores(PIVOTS[:5])
    rows = [
        [m["group"], m["row"], str(m["n_sets"]), a, *_cells(scores, columns)]
        for m in results["kind_line_means"]
        for a, scores in m["alphas"].items()
    ]
    header = ["kind of capture", "method", "sets", "α", *_titles(columns)]
    note = "Means over the sets of one kind of capture."
    return TextTable("kinds", "Pictures by kind of capture", note, header, rows, 2)


def _runs(results: Results, group: str) -> list[Mapping[str, Any]]:
    members = labels_in(results, group)
    return [run for run in results["runs"] if run["set"] in members]


def _scalar_rows(results: Results, group: str, columns: Columns) -> list[list[str]]:
    rows = [[run["set"], run["row"], *_cells(scalars(run), columns)] for run in _runs(results, group)]
    for means in results["means"]:
        if means["group"] == group and means["n_sets"] > 1:
            values, half = means["scalars"], means["half"]
            name = f"mean of {means['n_sets']}"
            cells = (with_half(values[k], half[k], form) for k, _, form in columns)
            rows.append([name, means["row"], *cells])
    return rows
