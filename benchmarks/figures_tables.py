"""Tables of docs/results.md from a benchmark's results.json: `python -m benchmarks figures` writes them."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from tg4mm.research.bench.means import half_of, mean_of_all, scalars
from tg4mm.research.evaluate.run import CEILING, STATIC

Results = Mapping[str, Any]
Made = dict[str, dict[str, Any]]  # {name: {header, rows}}, cells as text
_MEANS = (  # of the table of sets: name, key of `scalars`, factor and format
    ("mean of what can be observed", "displacement_error_observed", 100, "{:.1f}"),
    ("mean leak", "static_leak", 100, "{:.1f}"),
    ("mean amplitude ratio", "amplitude_ratio", 1, "{:.3f}"),
)
_OF_RIVALS = ("5", "20", "50")  # α
_OF_MIC = (  # row of line_means, key, title, format
    (STATIC, "ssim", "SSIM, nothing moves", "{:.4f}"),
    ("modal", "ssim", "SSIM, `modal`", "{:.4f}"),
    (CEILING, "ssim", "SSIM, ceiling", "{:.4f}"),
    ("modal", "closure", "closure", "{:.2f}"),
    ("modal", "ssim_moving", "SSIM where it moves, `modal`", "{:.4f}"),
    (CEILING, "ssim_moving", "the same, ceiling", "{:.4f}"),
)
_OF_SPLITS = (  # key, α, title, format
    ("closure", "20", "closure, α = 20", "{:.2f}"),
    ("closure", "50", "closure, α = 50", "{:.2f}"),
    ("gap", "20", "SSIM below the ceiling, 20", "{:.3f}"),
    ("lpips", "20", "LPIPS, 20", "{:.3f}"),
    ("flip", "20", "FLIP, 20", "{:.3f}"),
)
_MOVED = (  # key of `scalars`, title, factor and format
    ("displacement_error", "displacement error, %", 100, "{:.0f}"),
    ("displacement_error", "the same, between bins", 100, "{:.0f}"),
    ("static_leak", "leak, %", 100, "{:.0f}"),
    ("amplitude_ratio", "amplitude ratio", 1, "{:.2f}"),
    ("mac", "MAC", 1, "{:.2f}"),
    ("total_s", "training, s", 1, "{:.0f}"),
)


def number(form: str, value: float | None, half: float | None = None) -> str:
    """Without the 0 before the point where all digits after it count; after ± half of its interval."""
    if value is None:
        return ""
    text = form.format(value)
    text = text.removeprefix("0") if len(text) > 4 else text
    return text if half is None else f"{text} ± {number(form, half)}"


def five_tables(results: Results) -> Made:
    """SSIM of every method over α, error and MAC of every set, and what the methods cost."""
    return {"five_ssim": over_alpha(results), "five_sets": _by_set(results), "five_cost": _cost(results)}


def mic_table(results: Results) -> Made:
    """Scores over α of one set."""
    means = {m["row"]: m["alphas"] for m in results["line_means"]}
    alphas = sorted(means["modal"], key=float)
    rows = [
        [title, *(number(form, means[row][a].get(key)) for a in alphas)] for row, key, title, form in _OF_MIC
    ]
    return {"mic_512": {"header": ["", *(f"α = {a}" for a in alphas)], "rows": rows}}


def _named(row: str) -> str:
    name, colon, way = row.partition(":")
    return row if row in {STATIC, CEILING} else f"`{name}`{colon}{way}"


def rivals_tables(results: Results) -> Made:
    """SSIM and LPIPS of every row on every set, and displacement errors. A size other than 128² is named."""
    lines = {(x["set"], x["row"]): x["alphas"] for x in results["lines"]}
    sets, names = (list(dict.fromkeys(key[i] for key in lines)) for i in (0, 1))
    names.sort(key=lambda row: (row == CEILING) - (row == STATIC))
    places = [(label, a) for label in sets for a in _OF_RIVALS]
    rows = []
    for row in names:
        scores = (lines.get((label, row), {}).get(a, {}) for label, a in places)
        cells = ("/".join(number("{:.4f}", s[key]) for key in ("ssim", "lpips")) if s else "" for s in scores)
        rows.append([_named(row), *cells])
    sizes = {s["label"]: "" if s["width"] == 128 else f" {s['width']}²" for s in results["sets"]}
    title = {label: label.partition("_")[0] + sizes[label] for label in sets}
    header = ["SSIM/LPIPS at α", *(f"{title[label]}, {a}" for label, a in places)]
    errors = _by_set(results)
    own = errors["rows"][: len(sets)]  # the others are means
    errors["rows"] = [[name, *row[1:]] for name, row in zip(title.values(), own, strict=True)]
    return {"rivals": {"header": header, "rows": rows}, "rivals_errors": errors}


def merged(old: Made, new: Made) -> Made:
    """The tables; rows and columns that the new ones lack stay."""
    return old | {name: _merged(old[name], table) if name in old else table for name, table in new.items()}


def _merged(old: dict[str, Any], new: dict[str, Any]) -> dict[str, Any]:
    header, rows = (list(dict.fromkeys(names)) for names in (
        [*old["header"], *new["header"]], [row[0] for table in (old, new) for row in table["rows"]]
    ))  # fmt: skip
    cells = {
        (row[0], title): cell
        for table in (old, new)
        for row in table["rows"]
        for title, cell in zip(table["header"], row, strict=True)
        if cell
    }
    return {"header": header, "rows": [[cells.get((row, title), "") for title in header] for row in rows]}


def splits_tables(splits: Mapping[str, Results]) -> Made:
    """Scores and motion of splits, each mean ± half of its 95 % interval."""
    header, columns = [""], list[list[str]]()
    for split, results in splits.items():
        scenes = {s["label"]: s["scene"] for s in results["sets"]}
        between = {s["label"] for s in results["sets"] if s["frequency_hz"] % 1}  # bins of a second
        lines = {(x["row"], x["set"]): x["alphas"] for x in results["lines"]}
        of_modal = {x["set"]: scalars(x) for x in results["runs"] if x["row"] == "modal"}
        for row in dict.fromkeys(row for row, _ in lines if row != CEILING):
            header.append(f"`{split}`, {_named(row)}")
            column = []
            for key, a, _, form in _OF_SPLITS:
                at = {s: lines[row, s][a] | {"gap": _gap(lines, row, s, a)} for s in scenes}
                values = {} if (key, row) == ("closure", STATIC) else {s: x.get(key) for s, x in at.items()}
                column.append(_mean_of(values, scenes, form))
            for key, title, factor, form in _MOVED:
                some = of_modal if row == "modal" else {}
                some = {s: v for s, v in some.items() if "between" not in title or s in between}
                column.append(_mean_of({s: _times(v[key], factor) for s, v in some.items()}, scenes, form))
            columns.append(column)
    titles = [title for _, _, title, _ in _OF_SPLITS] + [title for _, title, _, _ in _MOVED]
    return {"splits": {"header": header, "rows": [list(row) for row in zip(titles, *columns, strict=True)]}}


def _gap(lines: Mapping[tuple[str, str], Any], row: str, label: str, alpha: str) -> float:
    return float(lines[CEILING, label][alpha]["ssim"] - lines[row, label][alpha]["ssim"])


def _mean_of(values: Mapping[str, float | None], scenes: Mapping[str, str], form: str) -> str:
    return number(form, mean_of_all(values.values()), half_of(values.items(), scenes)) if values else ""


def over_alpha(results: Results) -> dict[str, Any]:
    """SSIM of every row over α."""
    means = sorted(results["line_means"], key=lambda m: (m["row"] == CEILING) - (m["row"] == STATIC))
    alphas = sorted(means[0]["alphas"], key=float)
    rows = []
    for m in means:
        halves = m.get("half", {})
        cells = (number("{:.4f}", m["alphas"][a]["ssim"], halves.get(a, {}).get("ssim")) for a in alphas)
        rows.append([_named(m["row"]), *cells])
    return {"header": ["SSIM", *(f"α = {a}" for a in alphas)], "rows": rows}


def _by_set(results: Results) -> dict[str, Any]:
    means = {m["row"]: m for m in results["means"]}
    runs = {(run["set"], run["row"]): scalars(run) for run in results["runs"]}
    rows = [
        [label.partition("_")[0], *(_error(runs.get((label, row), {})) for row in means)]
        for label in dict.fromkeys(label for label, _ in runs)
    ]
    rows.append(["mean", *(_error(m["scalars"], m.get("half", {})) for m in means.values())])
    for title, key, factor, form in _MEANS:
        rows.append([title, *(number(form, _times(m["scalars"][key], factor)) for m in means.values())])
    return {"header": ["set", *map(_named, means)], "rows": rows}


def _error(values: Mapping[str, float | None], halves: Mapping[str, float | None] | None = None) -> str:
    """Displacement error in per cent, and MAC."""
    halves = halves or {}
    error = number("{:.1f}", *(_times(x.get("displacement_error"), 100) for x in (values, halves)))
    return ", ".join(filter(None, (error, number("{:.3f}", values.get("mac"), halves.get("mac")))))


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else factor * value


def _cost(results: Results) -> dict[str, Any]:
    header = ["method", "space, s", "motion, s", "iterations", "peak MiB, space and motion", "Gaussians",
              "on disk, MiB", "pictures a second"]  # fmt: skip
    rows = []
    for m in results["means"]:
        s = m["scalars"]
        iterations = (number("{:,.0f}", s[f"{stage}_iterations"]) for stage in ("space", "motion"))
        peaks = (number("{:.0f}", s[f"{stage}_peak_mib"]) for stage in ("space", "motion"))
        times = (number("{:.0f}", s[f"{stage}_s"]) for stage in ("space", "motion"))
        size = number("{:,.0f}", s["n_gaussians"]), number("{:.1f}", s["mib_on_disk"])
        speed = _range(x["frames_per_s"] for x in results["lines"] if x["row"] == m["row"]) or "–"
        rows.append([_named(m["row"]), *times, " and ".join(iterations), ", ".join(peaks), *size, speed])
    known = {m["row"] for m in results["means"]}
    for row in dict.fromkeys(x["row"] for x in results["lines"]):
        speed = _range(x["frames_per_s"] for x in results["lines"] if x["row"] == row)
        if speed and row.partition(":")[0] not in {*known, STATIC, CEILING}:
            rows.append([_named(row), *[""] * (len(header) - 2), speed])
    return {"header": header, "rows": rows}


def _range(values: Iterable[float | None]) -> str:
    known: Sequence[float] = [v for v in values if v]
    return f"{min(known):.0f} to {max(known):.0f}" if known else ""
