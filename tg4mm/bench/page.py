"""The pages of a benchmark in Markdown; on the terminal they are printed as they are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from tg4mm.bench.chart import curves
from tg4mm.bench.means import gap, scalars
from tg4mm.bench.table import NOTHING, shown, table
from tg4mm.evaluate.run import CEILING, STATIC

_VERDICTS = {True: "reached", False: "**missed**", None: "not judged"}
_SEEN = (("closure", "closure"), ("change_gain", "gain"), ("change_residual", "residual"))
_SEEN_TEXT = (
    "Closure: where SSIM lies between nothing moves (0) and the ceiling (1). Gain and residual: the picture's change "
    "by the method, regressed on its change by the exact motion of the same Gaussians; 1 and 0 would be exact."
)
_COSTS = (
    ("displacement_error", "displacement error", "{:.1%}"),
    ("static_leak", "static leak", "{:.1%}"),
    ("amplitude_ratio", "amplitude ratio", "{:.3f}"),
    ("direction_error_deg", "direction off, °", "{:.1f}"),
    ("space_s", "space, s", "{:.0f}"),
    ("motion_s", "motion, s", "{:.0f}"),
    ("motion_to_space", "motion / space", "{:.2f}"),
    ("peak_memory_mib", "peak, MiB", "{:.0f}"),
    ("n_gaussians", "Gaussians", "{:,.0f}"),
    ("mib_on_disk", "on disk, MiB", "{:.1f}"),
)


def scenes_page(results: Mapping[str, Any], pictures: Mapping[str, str]) -> str:
    """What becomes docs/results.md. pictures: {group: file name of its chart}."""
    parts = ["# Results", origin(results["made"]), _how(results), "## Goals", goals_table(results)]
    for group in dict.fromkeys(m["group"] for m in results["means"]):
        sets = [s["label"] for s in results["sets"] if s["group"] == group]
        parts += [f"## {group}", _sets_line(results, sets)]
        parts += ["### SSIM over magnification", _picture(pictures, group), ssim_table(results, group)]
        parts += ["### How much of the motion is seen", _SEEN_TEXT, change_table(results, group)]
        parts += ["### Motion and cost", cost_table(results, group)]
    parts += list(_remarks(results))
    return "\n\n".join(part for part in parts if part) + "\n"


def _picture(pictures: Mapping[str, str], group: str) -> str:
    return f"![SSIM over magnification, means, {group}]({pictures[group]})" if group in pictures else ""


def ssim_chart(results: Mapping[str, Any], group: str) -> str | None:
    """Means over the group's sets: a curve per preset and method between what frames it. None while there is none."""
    means = [m for m in results["means"] if m["group"] == group]
    alphas = sorted(dict.fromkeys(a for m in means for a in m["rows"] if float(a) > 0), key=float)
    series: dict[str, list[float | None]] = {}
    for m in means:
        for method in (STATIC, *_ways(results, m["row"]), CEILING):
            framing = method in {STATIC, CEILING}
            name = f"{method} ({m['row']})" if framing else _title(m["row"], method)
            series[name] = [m["rows"].get(a, {}).get(method, {}).get("ssim") for a in alphas]
    known = any(v is not None for values in series.values() for v in values)
    return curves(alphas, series, "magnification factor α", "SSIM") if known else None


def origin(made: Mapping[str, Any]) -> str:
    """The command, the machine, the day and the version, as a code block and a sentence."""
    load = "" if made["load_average"] is None else f", load average {made['load_average']:g} when it began"
    return (
        f"    {made['command']}\n\n"
        f"{made['date']}, tg4mm {made['tg4mm']}, Python {made['python']}, torch {made['torch']}; {made['system']}, "
        f"{made['processor']}, {made['cores']} cores, {made['threads']} threads{load}. Seconds depend on all of these."
    )


def _how(results: Mapping[str, Any]) -> str:
    band = (
        "Every method magnifies the same band: the motion's frequencies and 1.5 Hz on either side, as [TG4MM] §IV.B. "
        if results["band"]
        else "Every method magnifies all frequencies. "
    )
    return (
        band
        + "“Nothing moves” is the Gaussians at rest, the ceiling the exact motion applied to the same Gaussians; "
        "every preset has its own Gaussians, hence its own two. The gap is ceiling less method. "
        f"{_time_rule(results)}"
    )


def _time_rule(results: Mapping[str, Any]) -> str:
    rule = {
        "needed": "A `paper` preset that took less time than `modal` is trained once more",
        "always": "Every `paper` preset is trained once more",
        "never": "No preset is trained to another's time",
    }[results["same_time"]]
    if results["same_time"] == "never":
        return rule + "."
    return (
        rule
        + " with all its iterations scaled by the ratio of the two training times just measured (the row "
        "“modal's time”); the resulting settings stand below and repeat it anywhere. One that took longer than `modal` "
        "had the advantage already. Times are of training, without rendering."
    )


def goals_table(results: Mapping[str, Any]) -> str:
    rows = [[g["goal"], g["group"], _VERDICTS[g["reached"]], g["detail"]] for g in results["goals"]]
    if not rows:
        return "The preset `modal`, which the goals are for, was not run."
    return table(["goal (means over scenes)", "sets", "", "figure"], rows, text_columns=4)


def _sets_line(results: Mapping[str, Any], labels: list[str]) -> str:
    listed = [s for s in results["sets"] if s["label"] in labels]
    each = (
        f"{s['label']} ({s['n_views']} views × {s['n_timesteps']} timesteps, {s['frequency_hz']:g} Hz, "
        f"{s['amplitude_px']:.2g} px)"
        for s in listed
    )
    return (
        "Sets: " + "; ".join(each) + ". Amplitudes are the largest displacement in the first training camera."
    )


def _columns(results: Mapping[str, Any], group: str) -> list[tuple[str, str]]:
    """(row, method) pairs that the SSIM table of a group shows."""
    found: list[tuple[str, str]] = []
    for means in results["means"]:
        if means["group"] == group:
            found += [(means["row"], m) for m in (STATIC, *_ways(results, means["row"]), CEILING)]
    return found


def _ways(results: Mapping[str, Any], row: str) -> list[str]:
    return next(run["ways"] for run in results["runs"] if run["row"] == row)


def ssim_table(results: Mapping[str, Any], group: str) -> str:
    """A line per set and α, then the means; a column per preset and method, and the gap of each method."""
    columns = _columns(results, group)
    gaps = [(row, m) for row, m in columns if m not in {STATIC, CEILING}]
    header = ["set", "α", *(_title(r, m) for r, m in columns), *(f"gap {_title(r, m)}" for r, m in gaps)]
    lines: list[list[str]] = []
    members = [s["label"] for s in results["sets"] if s["group"] == group]
    for label in members:
        runs = {r["row"]: r for r in results["runs"] if r["set"] == label}
        alphas = dict.fromkeys(a for r in runs.values() for a in r["rows"] if float(a) > 0)
        for alpha in sorted(alphas, key=float):
            rows = {name: run["rows"].get(alpha, {}) for name, run in runs.items()}
            lines.append([label, alpha, *_ssims(rows, columns), *_gaps(rows, gaps)])
    means = {m["row"]: m for m in results["means"] if m["group"] == group}
    alphas = dict.fromkeys(a for m in means.values() for a in m["rows"] if float(a) > 0)
    for alpha in sorted(alphas, key=float):
        rows = {name: m["rows"].get(alpha, {}) for name, m in means.items()}
        differences = [shown(means[r]["gaps"].get(alpha, {}).get(m), "{:.4f}") for r, m in gaps]
        lines.append([f"**mean of {_count(means)}**", alpha, *_ssims(rows, columns), *differences])
    return table(header, lines)


def change_table(results: Mapping[str, Any], group: str) -> str:
    """A line per set and α, then the means: how much of the motion each method shows."""
    ways = [(row, m) for row, m in _columns(results, group) if m not in {STATIC, CEILING}]
    header = ["set", "α", *(f"{_title(*way)}: {title}" for way in ways for _, title in _SEEN)]
    lines: list[list[str]] = []
    for label in (s["label"] for s in results["sets"] if s["group"] == group):
        rows = {r["row"]: r["rows"] for r in results["runs"] if r["set"] == label}
        lines += [[label, a, *_seen(rows, a, ways)] for a in _alphas(rows)]
    means = {m["row"]: m for m in results["means"] if m["group"] == group}
    rows = {name: m["rows"] for name, m in means.items()}
    lines += [[f"**mean of {_count(means)}**", a, *_seen(rows, a, ways)] for a in _alphas(rows)]
    return table(header, lines)


def _alphas(rows: Mapping[str, Mapping[str, Any]]) -> list[str]:
    return sorted({a for own in rows.values() for a in own if float(a) > 0}, key=float)


def _seen(rows: Mapping[str, Mapping[str, Any]], alpha: str, ways: list[tuple[str, str]]) -> list[str]:
    values = [rows.get(row, {}).get(alpha, {}).get(m, {}) for row, m in ways]
    return [shown(value.get(key), "{:.2f}") for value in values for key, _ in _SEEN]


def _count(means: Mapping[str, Any]) -> str:
    numbers = sorted({m["n_sets"] for m in means.values()})
    return str(numbers[0]) if len(numbers) == 1 else f"{numbers[0]} to {numbers[-1]}"


def _title(row: str, method: str) -> str:
    if row == method:
        return row
    return f"{row}: {method}"


def _ssims(rows: Mapping[str, Mapping[str, Any]], columns: list[tuple[str, str]]) -> list[str]:
    return [shown(rows.get(row, {}).get(m, {}).get("ssim"), "{:.4f}") for row, m in columns]


def _gaps(rows: Mapping[str, Mapping[str, Any]], columns: list[tuple[str, str]]) -> list[str]:
    return [shown(gap(rows.get(row, {}), m), "{:.4f}") for row, m in columns]


def cost_table(results: Mapping[str, Any], group: str) -> str:
    """A line per set and preset, then the means: motion against the truth, seconds, memory, size."""
    members = {s["label"] for s in results["sets"] if s["group"] == group}
    lines = []
    for run in results["runs"]:
        if run["set"] in members:
            lines.append([run["set"], run["row"], *_scalar_cells(scalars(run))])
    for means in results["means"]:
        if means["group"] == group:
            lines.append([f"**mean of {means['n_sets']}**", means["row"], *_scalar_cells(means["scalars"])])
    return table(["set", "preset", *(title for _, title, _ in _COSTS)], lines, text_columns=2)


def _scalar_cells(values: Mapping[str, float | None]) -> list[str]:
    return [shown(values[key], form) for key, _, form in _COSTS]


def _remarks(results: Mapping[str, Any]) -> Iterator[str]:
    """Settings that differ from the defaults, and what an evaluation had to say."""
    given = {
        (run["row"], run["set"]): " ".join(f"--set {k}={v}" for k, v in run["overrides"].items())
        for run in results["runs"]
        if run["overrides"]
    }
    if given:
        lines = [f"- {row}, {label}: `{text}`" for (row, label), text in given.items()]
        yield "## Settings other than the defaults\n\n" + "\n".join(lines)
    notes: dict[str, list[str]] = {}
    for run in results["runs"]:
        missing = [f"not measured: {what}: {why}" for what, why in run["absent"].items() if what != "LPIPS"]
        for note in [*run["notes"], *missing]:
            if run["set"] not in notes.setdefault(note, []):
                notes[note].append(run["set"])
    if notes:
        yield "## Notes\n\n" + "\n".join(f"- {', '.join(labels)}: {note}" for note, labels in notes.items())


__all__ = ["NOTHING", "change_table", "cost_table", "goals_table", "origin", "scenes_page", "ssim_table"]
