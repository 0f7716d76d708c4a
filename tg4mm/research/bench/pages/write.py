"""Writes a benchmark's results.json, results.md, plots, tables for LaTeX, and one HTML page."""

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup, escape

from tg4mm.core.files import write_json
from tg4mm.core.pages.page import (
    Block,
    Commands,
    Figure,
    FigurePanel,
    Page,
    Section,
    Stat,
    Text,
    data_uri,
    render_page,
)
from tg4mm.core.pages.page import Table as PageTable
from tg4mm.research.bench.folder import write_text
from tg4mm.research.bench.means import scalars
from tg4mm.research.bench.pages import markdown
from tg4mm.research.bench.pages.shown import shown_sections
from tg4mm.research.bench.pages.tables import (
    full_table,
    groups_of,
    kinds_tables,
    labels_in,
    row_name,
    sets_in,
    tables_of,
)
from tg4mm.research.bench.scored import METRICS
from tg4mm.research.evaluate.run import CEILING, STATIC
from tg4mm.research.text import TextTable, latex_table

# Okabe and Ito's colours, distinct for colour-blind readers.
COLOURS = ("#c2500f", "#0072b2", "#009e73", "#cc79a7", "#8a6d00", "#56b4e9", "#5d3a9b", "#7a7f88")
_MARKS = "osD^vP*"  # one fewer than colours, so that no two of many rows look alike
_LEAST, _MOST = (
    -0.5,
    1.6,
)  # limits of closure and gain, so that one distant method does not compress the others
_SHOWN = ("ssim", "ssim_moving", "closure", "gain")
_HERE = Path(__file__).parent


def over_alpha(results: Mapping[str, Any], group: str) -> str | None:
    """Draw an SVG with four panels, SSIM, SSIM where it moves, closure and gain over α; None without an α above 0.

    Each method has a curve of means over the sets, of closure with 95 % intervals; rows for comparison are grey.
    """
    means = [m for m in results["line_means"] if m["group"] == group]
    alphas = sorted({a for m in means for a in m["alphas"] if float(a) > 0}, key=float)
    if not alphas:
        return None
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 7.4), layout="constrained")
    axes = figure.subplots(2, 2)
    every = sets_in(means)
    methods = [m["row"] for m in means if m["row"] not in {STATIC, CEILING}]
    for panel, key in zip(axes.flat, _SHOWN, strict=True):
        for m in means:
            points = [(float(a), v) for a in alphas if (v := m["alphas"].get(a, {}).get(key)) is not None]
            if points:
                halves = [m.get("half", {}).get(f"{a:g}", {}).get(key) or 0 for a, _ in points]
                style = {"label": row_name(m, every), "capsize": 2, **_style(m["row"], methods)}
                panel.errorbar(*zip(*points, strict=True), halves if key == "closure" else None, **style)
        panel.set_xlabel("magnification factor α")
        panel.set_ylabel(METRICS[key][0])
        panel.set_xscale("log")
        panel.set_xticks([float(a) for a in alphas], alphas)
        panel.minorticks_off()
        panel.grid(alpha=0.25)
        low, high = panel.get_ylim()
        if key in {"closure", "gain"} and (low < _LEAST or high > _MOST) and low < _MOST and high > _LEAST:
            panel.set_ylim(max(low, _LEAST), min(high, _MOST))
            panel.set_ylabel(f"{METRICS[key][0]} (cut to {_LEAST:g} … {_MOST:g})")
    handles, labels = axes.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(4, len(labels)), frameon=False)
    return svg(figure)


def size_and_speed(results: Mapping[str, Any], group: str) -> str | None:
    """Draw an SVG like [TG4MM] Fig. 6: the model's size (MiB) against pictures a second; None without any."""
    members = labels_in(results, group)
    points: dict[str, list[tuple[float, float]]] = {}
    for run in results["runs"]:
        for line in results["lines"]:
            same = line["set"] == run["set"] and line["row"].split(":")[0] == run["row"]
            if run["set"] in members and same and line["frames_per_s"]:
                points.setdefault(line["row"], []).append(
                    (scalars(run)["mib_on_disk"] or 0.0, line["frames_per_s"])
                )
    if not points:
        return None
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axes = figure.subplots()
    for row, found in points.items():
        x, y = (sum(v) / len(v) for v in zip(*found, strict=True))
        style = _style(row, list(points)) | {"linestyle": "none", "markersize": 9}
        axes.plot([x], [y], label=row, **style)
    axes.set_xlabel("model on disk, MiB")
    axes.set_ylabel("rendering, pictures/s")
    axes.margins(0.15)
    axes.set_xlim(left=0)
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.25)
    figure.legend(loc="outside right upper", frameon=False)
    return svg(figure)


def _style(row: str, rows: list[str]) -> dict[str, Any]:
    if row.startswith((STATIC, CEILING)):
        return {"color": "#9aa0a8", "linestyle": ":" if row.startswith(STATIC) else "--", "marker": "."}
    i = rows.index(row)
    colour, mark = COLOURS[i % len(COLOURS)], _MARKS[i % len(_MARKS)]
    return {"color": colour, "marker": mark, "markersize": 4, "linewidth": 1.8}


def svg(figure: Any) -> str:
    """Return the drawing, always with the same bytes."""
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    with matplotlib.rc_context({"svg.hashsalt": "tg4mm", "svg.fonttype": "none", "font.size": 10}):
        buffer = io.StringIO()
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None})  # `savefig` would draw twice
    return buffer.getvalue()


def write_results(out: Path, results: Mapping[str, Any]) -> None:
    """Write OUT/results.json, results.md, results_<i>.svg, results_<i>_size.svg, and tables/<i>_<name>.tex, kinds.tex.

    <i> counts groups of sets.
    """
    write_json(out / "results.json", results)
    before = {*out.glob("results_*.svg"), *(out / "tables").glob("*.tex")}
    pictures: dict[str, dict[str, str]] = {}
    for i, group in enumerate(groups_of(results), 1):
        drawings = {
            f"results_{i}.svg": ("SSIM and closure over magnification", over_alpha(results, group)),
            f"results_{i}_size.svg": ("Size of the model and speed", size_and_speed(results, group)),
        }
        for name, (title, drawn) in drawings.items():
            if drawn is not None:
                pictures.setdefault(group, {})[name] = f"{title}, {group}"
                write_text(out / name, drawn)
                before.discard(out / name)
        for made in (*tables_of(results, group), full_table(results, group)):
            file = out / "tables" / f"{i}_{made.key}.tex"
            write_text(file, latex_table(made, group))
            before.discard(file)
    for made in kinds_tables(results):
        write_text(out / "tables" / f"{made.key}.tex", latex_table(made))
        before.discard(out / "tables" / f"{made.key}.tex")
    for old in before:
        old.unlink()  # of methods or groups that are no longer in the results
    write_text(out / "results.md", markdown.scenes_page(results, pictures))


def write_page(out: Path, results: Mapping[str, Any]) -> Path:
    """Write OUT/results.html, and figures, after `write_results`, with the pictures in OUT/runs; returns it."""
    sections: list[Section] = []
    for i, group in enumerate(groups_of(results), 1):
        sections.append(Section(f"Scores, {group}", list(_scores(out, results, i, group))))
        sections += shown_sections(out, results, group)
    sections += [Section(made.title, [_block(made)]) for made in kinds_tables(results)]
    left_out, note = markdown.failures(results), Markup('<p class="note">Left out:</p>{}')
    made = Commands([(markdown.machine(results["made"]), results["made"]["command"])])
    page = Page(
        title="3D motion magnification, measured",
        kicker="tg4mm benchmark",
        summary=_summary(results),
        stats=_stats(results),
        lead=[
            Text(markdown.how(results)),
            Text(_list(markdown.about_methods(results)), plain=True),
            *([Text(note.format(_list(left_out)), plain=True)] if left_out else []),
        ],
        sections=[
            *sections,
            *(Section(title, [Text(_list(lines), plain=True)]) for title, lines in markdown.remarks(results)),
            Section("How it was made", [made]),
        ],
        footer="Protocol: docs/protocol.md. Tables for LaTeX lie in tables/, slices and difference maps in figures/, "
        "all figures in results.json.",
    )
    style, script = ((_HERE / name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    target = Path(out) / "results.html"
    write_text(target, render_page(page, style, script))
    return target


def _summary(results: Mapping[str, Any]) -> str:
    rows = list(dict.fromkeys(line["row"] for line in results["lines"]))
    n_sets = len({line["set"] for line in results["lines"]})
    alphas = sorted({a for line in results["lines"] for a in line["alphas"] if float(a) > 0}, key=float)
    counts = f"{len(rows)} row{'s' * (len(rows) != 1)} on {n_sets} dataset{'s' * (n_sets != 1)}"
    return f"{counts}, magnified by α = {', '.join(alphas)}: every row's pictures of test views against ground truth."


def _stats(results: Mapping[str, Any]) -> list[Stat]:
    """Return the best SSIM where it moves at each of three α, and its method, of the first group's means."""
    groups = groups_of(results)
    means = [m for m in results["line_means"] if m["group"] == groups[0]]
    every = sets_in(means)
    means = [m for m in means if set(m["sets"]) == every]  # means over other sets cannot be compared
    where = f"; {groups[0]}" if len(groups) > 1 else ""
    alphas = sorted({a for m in means for a in m["alphas"] if float(a) > 0}, key=float)
    found = []
    for alpha in dict.fromkeys([*alphas[:1], *alphas[len(alphas) // 2 :][:1], *alphas[-1:]]):
        known = [(m["alphas"][alpha].get("ssim_moving"), m["row"]) for m in means if alpha in m["alphas"]]
        scored = [(v, row) for v, row in known if v is not None and row not in {STATIC, CEILING}]
        still = next((v for v, row in known if row == STATIC and v is not None), None)
        if scored:
            best = max(scored)
            beside = "" if still is None else f"; nothing moves {still:.4f}"
            title = f"Best SSIM where it moves, α = {alpha}"
            found.append(Stat(title, f"{best[0]:.4f}", "", f"{best[1]}{beside}{where}"))
    return found


def _list(lines: Sequence[str]) -> Markup:
    code = [re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(line))) for line in lines]
    items = Markup("").join(Markup(f"<li>{line}</li>") for line in code)
    return Markup("<ul>{}</ul>").format(items)


def _scores(out: Path, results: Mapping[str, Any], i: int, group: str) -> Iterator[Block]:
    yield Text(markdown.sets_line(results, group))
    speed = "Size of the trained model, and speed of posing and rendering."
    for name, caption, width in (
        (f"results_{i}.svg", "Means over the sets. Grey: rows for comparison.", "wide"),
        (f"results_{i}_size.svg", speed, "narrow"),
    ):
        if (out / name).exists():
            source = data_uri("image/svg+xml", (out / name).read_bytes())
            yield Figure([FigurePanel("img", source=source, alt=caption)], caption, width=width)
    for made in (*tables_of(results, group), full_table(results, group)):
        yield _block(made)


def _block(made: TextTable) -> PageTable:
    return PageTable(made.header, made.rows, f"{made.title}. {made.note}", left=made.text_columns)
