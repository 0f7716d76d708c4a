"""An ablation's results.json read back, and its table, page and picture."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tg4mm.core.records import read_formed
from tg4mm.core.values import Just, Maybe
from tg4mm.research.bench import BenchError
from tg4mm.research.bench.folder import CIRCUMSTANCES, FORMAT, VERSION
from tg4mm.research.bench.means import mean_of_all
from tg4mm.research.bench.measure import OF_RUN
from tg4mm.research.bench.pages.markdown import markdown, not_there, origin, trained_otherwise
from tg4mm.research.bench.pages.plots import curves
from tg4mm.research.evaluate.run import CEILING, STATIC
from tg4mm.research.text import Table, shown

# Columns by key of a line's `scalars`: title, format.
COLUMNS = {
    "init": ("started from", "{}"),
    "psnr_rest": ("ceiling's PSNR α = 0, dB", "{:.2f}"),
    "n_gaussians": ("Gaussians", "{:,.0f}"),
    "displacement_error": ("displacement error", "{:.1%}"),
    "displacement_error_observed": ("error, observed", "{:.1%}"),
    "static_leak": ("static leak", "{:.1%}"),
    "amplitude_ratio": ("amplitude ratio", "{:.3f}"),
    "direction_error_deg": ("direction off, °", "{:.1f}"),
    "frequency_error_hz": ("frequency off, Hz", "{:.3f}"),
    "filter_phase_deg": ("phase, °", "{:+.1f}"),
    "filter_error": ("filter's error", "{:.1%}"),
    "space_s": ("space, s", "{:.0f}"),
    "motion_s": ("motion, s", "{:.0f}"),
    "total_s": ("both stages, s", "{:.0f}"),
    "mib_on_disk": ("on disk, MiB", "{:.1f}"),
}
SSIM, LPIPS = "ssim", "lpips"


def ablation_table(results: Mapping[str, Any]) -> str:
    """The table in Markdown."""
    return markdown(ablation_cells(results))


def ablation_cells(results: Mapping[str, Any]) -> Table:
    """SSIM (LPIPS, if measured) of rows and methods at every α beside what frames them, and the row's figures."""
    columns = ssim_columns(results)
    header = ["set", results["title"], "method", *(f"SSIM {c}" for c in columns)]
    header += [f"LPIPS {c}" for c in columns if _has_lpips(results["lines"])]
    header += [COLUMNS[key][0] for key in results["columns"]]
    cells: list[list[str]] = []
    for data in results["sets"]:
        lines = [line for line in results["lines"] if line["set"] == data["label"]]
        cells += _cells(results, lines, columns)
    if len({line["set"] for line in results["lines"]}) > 1:
        cells += _cells(results, mean_lines(results, columns), columns)
    note = results["remark"] or f"{results['source']}."
    return Table(results["name"], results["title"], note, header, cells, 3)


def ssim_columns(results: Mapping[str, Any]) -> list[str]:
    """Titles of the SSIM columns, of all lines, by α or pixels."""
    titles = dict.fromkeys(title for line in results["lines"] for title in line["ssim_columns"])
    return sorted(titles, key=lambda t: float(t.replace("α = ", "").replace(" px", "")))


def _cells(
    results: Mapping[str, Any], lines: Sequence[Mapping[str, Any]], columns: Sequence[str]
) -> list[list[str]]:
    """The rows of one dataset. Where all have the same Gaussians, what frames them is printed once."""
    blank = [""] * len(results["columns"])
    once, lpips = _same_frames(lines, columns), _has_lpips(results["lines"])
    cells = []
    for i, line in enumerate(lines):
        own = [shown(line["scalars"].get(key), COLUMNS[key][1]) for key in results["columns"]]
        methods = [(STATIC, blank)] if not once or i == 0 else []
        methods += [(way, own if j == 0 else blank) for j, way in enumerate(line["ways"])]
        methods += [(CEILING, blank)] if not once or i == len(lines) - 1 else []
        for method, figures in methods:
            named = "" if once and method in {STATIC, CEILING} else line["row"]
            title = "" if method == line["row"] else method
            scores = _ssims(line, method, columns)
            scores += [shown(ssim_of(line, method, c, LPIPS), "{:.4f}") for c in columns if lpips]
            cells.append([line["set"], named, title, *scores, *figures])
    return cells


def _has_lpips(lines: Sequence[Mapping[str, Any]]) -> bool:
    return any(
        x.get(LPIPS) is not None for line in lines for row in line["rows"].values() for x in row.values()
    )


def _same_frames(lines: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> bool:
    """Whether all lines show the same for the rest pose and the exact motion: they share their Gaussians."""
    return all(len({tuple(_ssims(x, name, columns)) for x in lines}) == 1 for name in (STATIC, CEILING))


def _ssims(line: Mapping[str, Any], method: str, columns: Sequence[str]) -> list[str]:
    return [shown(ssim_of(line, method, c), "{:.4f}") for c in columns]


def ssim_of(line: Mapping[str, Any], method: str, column: str, metric: str = SSIM) -> float | None:
    alpha = line["ssim_columns"].get(column)
    return None if alpha is None else line["rows"][alpha].get(method, {}).get(metric)


def _means(lines: Sequence[Mapping[str, Any]], method: str, column: str) -> dict[str, float | None]:
    return {k: mean_of_all(ssim_of(x, method, column, k) for x in lines) for k in (SSIM, LPIPS)}


def mean_lines(results: Mapping[str, Any], columns: Sequence[str]) -> list[dict[str, Any]]:
    """Lines like those of a dataset, of means over the datasets that have any; of rows that all of them have.

    None where a dataset lacks what others have: means of different scenes must not stand in one column. A figure that a
    dataset has for no row is the mean of the others in every row.
    """
    found = []
    measured = {
        (x["set"], k) for x in results["lines"] for k, value in x["scalars"].items() if value is not None
    }
    n_sets = len({line["set"] for line in results["lines"]})
    for row in results["rows"]:
        lines = [line for line in results["lines"] if line["row"] == row]
        if len(lines) < n_sets:
            continue
        methods = [STATIC, *lines[0]["ways"], CEILING]
        found.append(
            {
                "set": f"mean of {len(lines)}",
                "row": row,
                "ways": lines[0]["ways"],
                "ssim_columns": {c: c for c in columns},
                "rows": {c: {m: _means(lines, m, c) for m in methods} for c in columns},
                "scalars": {
                    key: _mean([x["scalars"].get(key) for x in lines if (x["set"], key) in measured])
                    for key in results["columns"]
                },
            }
        )
    return found


def _mean(values: Sequence[Any]) -> Any:
    """Of numbers; texts are kept where all are the same."""
    if any(isinstance(v, str) for v in values):
        return values[0] if len(set(values)) == 1 else "differs"
    return mean_of_all(values)


def ablation_page(results: Mapping[str, Any], has_picture: bool) -> str:
    parts = [
        f"# {results['title']}",
        f"{results['source']}. Preset `{results['preset']}`.",
        origin(results["made"]),
        not_there(results),
    ]
    if results["lines"]:
        parts.append(ablation_table(results))
    if has_picture:
        parts.append(f"![{results['title']}](results.svg)")
    if results.get("slices"):
        parts += ["![Space-time slices](slices.png)", results["slices"]]
    if results["remark"]:
        parts.append(results["remark"])
    parts.append(_trained_with(results))
    runs = {f"{line['row']} on {line['set']}": line for line in results["lines"]}
    parts += [
        f"Trained by other code or elsewhere: {text}." for text in trained_otherwise(results["made"], runs)
    ]
    notes = {note: None for line in results["lines"] for note in line["notes"]}
    parts += [f"Note: {note}" for note in notes]
    return "\n\n".join(part for part in parts if part) + "\n"


def _trained_with(results: Mapping[str, Any]) -> str:
    """What every row was trained with, beyond the preset."""
    given = dict.fromkeys(
        f"- {line['row']}: `{' '.join(f'--set {k}={v}' for k, v in line['overrides'].items())}`"
        for line in results["lines"]
        if line["overrides"]
    )
    return "Settings:\n\n" + "\n".join(given) if given else ""


def picture(results: Mapping[str, Any]) -> str | None:
    """The chart: SSIM over α with a curve for each row, or a figure over the rows with a curve for each dataset.

    None while there is nothing to draw.
    """
    if not results["lines"]:
        return None
    return _over_alpha(results) if results["picture"] == SSIM else _over_rows(results)


def _over_rows(results: Mapping[str, Any]) -> str:
    """A figure of the motion; where rows scale different settings, a curve for each of them."""
    key, names = results["picture"], [c for c in dict.fromkeys(results["curves"]) if c] or [""]
    several = len(names) > 1
    ticks = sorted(dict.fromkeys(results["ticks"]), key=_factor) if several else results["ticks"]
    series: dict[str, list[float | None]] = {}
    for data in results["sets"]:
        of_row = {x["row"]: x["scalars"].get(key) for x in results["lines"] if x["set"] == data["label"]}
        for name in names:
            rows = zip(results["ticks"], results["curves"], results["rows"], strict=True)
            at = {tick: of_row.get(row) for tick, curve, row in rows if not several or curve in {"", name}}
            series[f"{data['label']}, {name}" if several else data["label"]] = [
                at.get(tick) for tick in ticks
            ]
    apart = results["apart"]
    breaks = [i for i in range(1, len(apart)) if apart[i] or apart[i - 1]]
    return curves(ticks, series, results["x_label"] or results["title"], COLUMNS[key][0], breaks)


def _factor(tick: str) -> float:
    return float(tick.removeprefix("× "))


def _over_alpha(results: Mapping[str, Any]) -> str:
    """Means over the datasets, of rows that all have; what frames them where it is the same for all rows."""
    columns = ssim_columns(results)
    several_sets = len({line["set"] for line in results["lines"]}) > 1
    lines = mean_lines(results, columns) if several_sets else results["lines"]
    shared = bool(lines) and _same_frames(lines, columns)
    series: dict[str, list[float | None]] = {}

    def curve(name: str, line: Mapping[str, Any], method: str) -> None:
        series[name] = [ssim_of(line, method, c) for c in columns]

    if shared:
        curve(STATIC, lines[0], STATIC)
    for line in lines:
        for way in line["ways"]:
            curve(f"{line['row']}, {way}" if len(line["ways"]) > 1 else line["row"], line, way)
    if shared:
        curve(CEILING, lines[0], CEILING)
    return curves([c.replace("α = ", "") for c in columns], series, "magnification factor α", "SSIM")


FILE = "results.json"
_LINE = {
    **OF_RUN,
    "set": str,
    "row": str,
    "ways": [str],
    "overrides": {str: str},
    "scalars": {"init?": Maybe(str), str: Maybe(float)},
    "ssim_columns": {str: str},
}
FORM = {
    "format": Just(FORMAT),
    "version": Just(VERSION),
    "kind": Just("ablation"),
    **dict.fromkeys(("name", "title", "source", "preset", "remark", "x_label", "picture"), str),
    **{key: [str] for key in ("columns", "rows", "ticks", "curves")},
    "apart": [bool],
    "sets": [{"label": str}],
    "lines": [_LINE],
    **{key: [dict.fromkeys(("set", "method", "why"), str)] for key in ("left_out", "failed")},
    "slices?": str,
    "made": CIRCUMSTANCES,
}


def read_ablation(folder: Path) -> dict[str, Any]:
    """results.json of an ablation. Raises BenchError for what is not there, damaged, or not of this version."""
    file = Path(folder) / FILE
    try:
        found = read_formed(file, FORM)
        _check_names(found)
    except OSError as error:
        raise BenchError(f"{file}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise BenchError(f"{file}: {error}; run the ablation's command again") from None
    return found


def _check_names(found: dict[str, Any]) -> None:
    """Raises ValueError where a name stands for nothing."""
    if unknown := [c for c in found["columns"] if c not in COLUMNS]:
        raise ValueError(f"column {unknown[0][:60]!r} is unknown")
    if found["picture"] not in {SSIM, *COLUMNS}:
        raise ValueError(f"picture is {found['picture'][:60]!r}, which is no figure")
    if len({len(found[key]) for key in ("rows", "ticks", "curves", "apart")}) > 1:
        raise ValueError("rows, ticks, curves and apart differ in number")
    if len({curve for curve in found["curves"] if curve}) > 1:
        _check_numbers(found["ticks"], "× ", "", "tick")
    for line in found["lines"]:
        _check_numbers(list(line["ssim_columns"]), "α = ", " px", "column")
        if unknown := [a for a in line["ssim_columns"].values() if a not in line["rows"]]:
            raise ValueError(f"α = {unknown[0][:60]} has no scores")


def _check_numbers(titles: list[str], before: str, after: str, what: str) -> None:
    for title in titles:
        try:
            float(title.replace(before, "").replace(after, "") if after else title.removeprefix(before))
        except ValueError:
            raise ValueError(f"{what} {title[:60]!r} holds no number") from None
