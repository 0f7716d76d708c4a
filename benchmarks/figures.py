"""The figures of README.md and docs/results.md: all their tables of the benchmark are written from docs/figures.json.

    python -m benchmarks figures                             # writes the tables and docs/error_over_noise.svg anew
    python -m benchmarks figures --results eight.json --dev results.json --bounds bounds.md    # takes these first

A table stands between `<!-- figures: NAME -->` and `<!-- end -->`; a table of the file need not stand on a page.
"""

import argparse
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core.errors import Tg4mmError
from tg4mm.research.bench.means import half_width, scalars
from tg4mm.research.bench.pages.write import COLOURS, svg
from tg4mm.research.evaluate.run import CEILING, STATIC

Results = Mapping[str, Any]
Made = dict[str, dict[str, Any]]  # {name: {header, rows}}, cells as text


def number(form: str, value: float | None, half: float | None = None) -> str:
    """Without the 0 before the point where all digits after it count; after ± half of its interval."""
    if value is None:
        return ""
    text = form.format(value)
    text = text.removeprefix("0") if len(text) > 4 else text
    return text if half is None else f"{text} ± {number(form, half)}"


def split_tables(results: Results, split: str) -> Made:
    """Closure and SSIM of every method over α, error and MAC of every set."""
    alphas = sorted((a for a in results["lines"][0]["alphas"] if float(a) > 0), key=float)
    return {split: over_alpha(pictures_table(results, alphas)), f"{split}_sets": _by_set(results)}


def bounds_table(text: str, group: str) -> Made:
    """Rows of `python -m benchmarks bounds`, named with their group, `mic 5 Hz, dev`; of `dev` bounds beside errors."""
    head, _, *rows = [line.strip("| \n").split(" | ") for line in text.splitlines() if line.startswith("|")]
    made = {"bounds": {"header": head, "rows": [[f"{_set_name(row[0])}, {group}", *row[1:]] for row in rows]}}
    beside = {"header": ["set", *head[-3:]], "rows": [[_set_name(row[0]), *row[-3:]] for row in rows]}
    return made | ({"dev_sets": beside} if group == "dev" else {})


def _set_name(label: str) -> str:
    """`mic_4_3Hz_0_5px` is `mic 4.3 Hz`."""
    scene, _, rest = label.partition("_")
    return f"{scene} {rest.partition('Hz')[0].replace('_', '.')} Hz" if "Hz" in rest else label


def _named(row: str) -> str:
    name, colon, way = row.partition(":")
    return row if row in {STATIC, CEILING} else f"`{name}`{colon}{way}"


def rivals_tables(results: Results) -> Made:
    """SSIM and LPIPS of every row on every set, and displacement errors."""
    pictures = pictures_table(results, ("5", "20", "50"))
    errors = _by_set(results)  # after the sets stand means
    names = list(dict.fromkeys(title.rpartition(", ")[0] for title in pictures["header"][1:]))
    errors["rows"] = [[name, *row[1:]] for name, row in zip(names, errors["rows"], strict=False)]
    return {"rivals": pictures, "rivals_errors": errors}


def pictures_table(results: Results, alphas: Sequence[str]) -> dict[str, Any]:
    """SSIM and LPIPS of every row on every set of the largest group. A size other than 128² is named."""
    most = max((m["sets"] for m in results["line_means"]), key=len)  # other groups have other sizes
    lines = {(x["set"], x["row"]): x["alphas"] for x in results["lines"] if x["set"] in most}
    sets, names = (list(dict.fromkeys(key[i] for key in lines)) for i in (0, 1))
    names.sort(key=lambda row: (row == CEILING) - (row == STATIC))
    places, rows = [(label, a) for label in sets for a in alphas], []
    for row in names:
        scores = (lines.get((label, row), {}).get(a, {}) for label, a in places)
        cells = (
            "/".join(filter(None, (number("{:.4f}", s.get(key)) for key in ("ssim", "lpips"))))
            for s in scores
        )
        rows.append([_named(row), *cells])
    width = {s["label"]: s["width"] for s in results["sets"]}
    title = {x: _set_name(x) if len(most) > 8 else x.partition("_")[0] for x in sets}
    title = {x: name + ("" if width[x] == 128 else f" {width[x]}²") for x, name in title.items()}
    return {"header": ["SSIM/LPIPS at α", *(f"{title[label]}, {a}" for label, a in places)], "rows": rows}


def merged(old: Made, new: Made) -> Made:
    """The tables; rows and columns that the new ones lack stay."""
    return old | {name: _merged(old[name], table) if name in old else table for name, table in new.items()}


def _merged(old: dict[str, Any], new: dict[str, Any]) -> dict[str, Any]:
    header = list(dict.fromkeys([*old["header"], *new["header"]]))
    rows = list(dict.fromkeys(row[0] for table in (old, new) for row in table["rows"]))
    cells = {
        (row[0], title): cell
        for table in (old, new)
        for row in table["rows"]
        for title, cell in zip(table["header"], row, strict=True)
        if cell
    }
    return {"header": header, "rows": [[cells.get((row, title), "") for title in header] for row in rows]}


def over_alpha(pictures: dict[str, Any]) -> dict[str, Any]:
    """Closure, with half of its 95 % interval, and SSIM over α, of every row of `pictures_table`."""
    places = [tuple(title.rpartition(", ")[::2]) for title in pictures["header"][1:]]
    ssim = {
        row[0]: {at: float(cell.partition("/")[0]) for at, cell in zip(places, row[1:], strict=True) if cell}
        for row in pictures["rows"]
    }
    still, best, most, rows = ssim[STATIC], ssim[CEILING], len({x for x, _ in places}), []
    alphas = list(dict.fromkeys(a for _, a in places))
    for name, own in ssim.items():
        cells = []
        for alpha in alphas:
            at = [(x, a) for x, a in own if a == alpha]
            closures = [(own[x] - still[x]) / (best[x] - still[x]) for x in at]
            half = half_width(closures, [x.partition(" ")[0] for x, _ in at])
            shown = number("{:.2f}", float(np.mean(closures)), half if half and half > 1e-9 else None)
            cells.append(f"{shown}, {number('{:.4f}', float(np.mean([own[x] for x in at])))}")
        count = len({x for x, _ in own})
        rows.append([name + ("" if count == most else f", {count} of {most} sets"), *cells])
    return {"header": ["closure, SSIM", *(f"α = {a}" for a in alphas)], "rows": rows}


def noise_plot(rows: list[list[str]], header: list[str]) -> str:
    """SVG of error and bounds of every row of the table of bounds, over the error that noise alone leaves."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axes = figure.subplots()
    for title, colour, mark in zip(("error, %", "bound, %", "parts known, %"), COLOURS, "o_x", strict=False):
        cells = [[row[header.index(key)] for key in ("noise, %", title)] for row in rows]
        points = [(max(float(x), 1), float(y)) for x, y in cells if x and y]
        axes.plot(*zip(*points, strict=True), mark, color=colour, label=title.removesuffix(", %"))
    axes.set(xscale="log", yscale="log", xlabel="error by noise alone, %", ylabel="displacement error, %")
    axes.grid(alpha=0.25, which="both")
    axes.legend(frameon=False)
    return svg(figure)


def _by_set(results: Results) -> dict[str, Any]:
    means = {m["row"]: m for m in sorted(results["means"], key=lambda m: m["n_sets"])}
    runs = {(run["set"], run["row"]): scalars(run) for run in results["runs"]}
    sets = dict.fromkeys(label for label, _ in runs)
    rows = [[_set_name(x), *(_error(runs.get((x, row), {})) for row in means)] for x in sets]
    most = max(m["n_sets"] for m in means.values())
    mean = (_error(m["scalars"], m.get("half", {})) if m["n_sets"] == most else "" for m in means.values())
    rows.append(["mean", *mean])
    return {"header": ["set", *map(_named, means)], "rows": rows}


def _error(values: Mapping[str, float | None], halves: Mapping[str, float | None] | None = None) -> str:
    """Displacement error in per cent, and MAC."""
    halves = halves or {}
    both = (x.get("displacement_error") for x in (values, halves))
    error = number("{:.1f}", *(None if e is None else 100 * e for e in both))
    return ", ".join(filter(None, (error, number("{:.3f}", values.get("mac"), halves.get("mac")))))


def with_mean(rows: list[list[str]]) -> list[list[str]]:
    """The rows of sets, `error, MAC` of every method, and their mean with half of its 95 % interval."""
    rows = [row for row in rows if row[0] != "mean"]
    scenes, mean = [row[0].partition(" ")[0] for row in rows], ["mean"]
    for column in zip(*(row[1:] for row in rows), strict=True):
        both = np.array([[float(x) for x in cell.split(", ")] for cell in column if cell]).T
        of = [scene for scene, cell in zip(scenes, column, strict=True) if cell]
        forms = zip(("{:.1f}", "{:.3f}"), both, strict=True)
        mean.append(", ".join(number(form, float(x.mean()), half_width(x, of)) for form, x in forms))
    return [*rows, mean]


ROOT = Path(__file__).parents[1]
FILE = ROOT / "docs" / "figures.json"
PAGES = (ROOT / "README.md", ROOT / "docs" / "results.md")
_FILES = ("--results", "--dev", "--test", "--large", "--rivals", "--bounds")
OPTIONS = dict.fromkeys(_FILES, "") | {"--group": "dev"}
_MOTION = {  # by key of `means.scalars`: title, format, factor
    "displacement_error": ("error, %", "{:.1f}", 100),
    "displacement_error_observed": ("of what can be observed, %", "{:.1f}", 100),
    "static_leak": ("leak, %", "{:.1f}", 100), "amplitude_ratio": ("amplitude ratio", "{:.3f}", 1),
    "direction_error_deg": ("direction off, °", "{:.1f}", 1), "mac": ("MAC", "{:.3f}", 1),
}  # fmt: skip
_ROWS = ("nothing moves", "modal", "ceiling")
_LOST_AT = ("20", "50")  # α
_LOST = f"SSIM (similarity) lost against the same Gaussians with exact motion, at α = {' / '.join(_LOST_AT)}"
_SHORT = "eight generated scenes, 128×128, 30 cameras, motion of about 0.2 pixels"


def figures_of(results: Mapping[str, Any]) -> dict[str, Any]:
    """Return {scenes: {name: {key: figure}}, ssim: {row: {α: mean}}} of `modal`, from a benchmark's results."""
    runs = {run["set"].partition("_")[0]: scalars(run) for run in results["runs"] if run["row"] == "modal"}
    means = {m["row"]: m["alphas"] for m in results["line_means"] if m["row"] in _ROWS}
    return {
        "scenes": {name: {key: values[key] for key in _MOTION} for name, values in runs.items()},
        "ssim": {row: {a: scores["ssim"] for a, scores in means[row].items()} for row in _ROWS},
    }


def tables(figures: Mapping[str, Any]) -> dict[str, str]:
    """{name: Markdown}: every scene, the short table of README, and those of the file."""
    scenes, ssim = figures["scenes"], figures["ssim"]
    mean = {key: sum(values[key] for values in scenes.values()) / len(scenes) for key in _MOTION}
    half = {
        k: half_width([x * v[k] for v in scenes.values()], list(scenes)) for k, (_, _, x) in _MOTION.items()
    }
    motion = [
        [name, *(number(f, v[k] * x) for k, (_, f, x) in _MOTION.items())] for name, v in scenes.items()
    ]
    motion.append(["mean", *(number(f, mean[k] * x, half[k]) for k, (_, f, x) in _MOTION.items())])
    lost = [number("{:.4f}", ssim["ceiling"][a] - ssim["modal"][a]) for a in _LOST_AT]
    errors = {name: values["displacement_error"] for name, values in scenes.items()}
    best, worst = min(errors, key=errors.__getitem__), max(errors, key=errors.__getitem__)
    why = f": {note}" if (note := figures.get("notes", {}).get(worst)) else ""
    cells = (
        f"{100 * mean['displacement_error']:.0f} ± {half['displacement_error'] or 0:.0f} %",
        f"{100 * errors[best]:.0f} % ({best})",
        f"{100 * errors[worst]:.0f} % ({worst}{why})",
    )
    others = {name: _markdown(made["header"], made["rows"]) for name, made in figures["tables"].items()}
    return others | {
        "scenes": _markdown(["set", *(title for title, _, _ in _MOTION.values())], motion),
        "short": _markdown(
            [_SHORT, "mean ± 95 % confidence interval", "best", "worst"],
            [
                ["displacement error, rms, relative to the true motion", *cells],
                [_LOST, " / ".join(lost), "", ""],
            ],
        ),
    }


def filled(page: str, made: Mapping[str, str]) -> str:
    """The page with each table in its place. Raises Tg4mmError for a mark without its end."""
    part = re.compile(r"(<!-- figures: (\w+) -->\n)(?:(?!<!-- figures).)*?(?<=\n)(<!-- end -->)", re.DOTALL)
    text, n = part.subn(lambda found: f"{found[1]}{made[found[2]]}\n{found[3]}", page)
    if n != page.count("<!-- figures: "):
        raise Tg4mmError(f"of {page.count('<!-- figures: ')} marks of figures {n} have an end")
    return text


def _markdown(header: list[str], rows: list[list[str]]) -> str:
    dashes = "|:--|" + "--:|" * (len(header) - 1)
    return "\n".join([_row(header), dashes, *map(_row, rows)])


def _row(cells: list[str]) -> str:
    return "".join(f"| {cell} " if cell else "| " for cell in cells) + "|"


def _read(path: str) -> Any:
    return json.loads(Path(path).read_text(encoding="utf-8"))


def run(options: argparse.Namespace) -> None:
    figures = json.loads(FILE.read_text(encoding="utf-8"))
    if options.results:
        figures |= figures_of(_read(options.results))
    for split in [name for name in ("dev", "test", "large") if vars(options)[name]]:
        figures["tables"] = merged(figures["tables"], split_tables(_read(vars(options)[split]), split))
    if options.large:  # of a part of the sets the rest stays; the means are of all
        own = {"large_pictures": rivals_tables(_read(options.large))["rivals"]}
        made = merged(figures["tables"], own)
        made["large"] = over_alpha(made["large_pictures"])
        made["large_sets"]["rows"] = with_mean(made["large_sets"]["rows"])
        figures["tables"] = made
    if options.bounds:
        text = Path(options.bounds).read_text(encoding="utf-8")
        figures["tables"] = merged(figures["tables"], bounds_table(text, options.group))
    if options.rivals:  # of a part of the sets and methods the rest stays; 256² has a table of its own
        made = rivals_tables(_read(options.rivals))
        if all("256²" in title for title in made["rivals"]["header"][1:]):
            made["rivals_256"] = made.pop("rivals")
        figures["tables"] = merged(figures["tables"], made)
    FILE.write_text(json.dumps(figures, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    plot = noise_plot(**figures["tables"]["bounds"])
    (ROOT / "docs" / "error_over_noise.svg").write_text(plot, encoding="utf-8")
    for page in PAGES:
        page.write_text(filled(page.read_text(encoding="utf-8"), tables(figures)), encoding="utf-8")
        print(page)
