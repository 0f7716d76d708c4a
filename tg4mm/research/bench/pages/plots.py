"""The benchmark's plots, drawn by matplotlib: scores over magnification, size against speed."""

import io
from collections.abc import Mapping
from typing import Any

from tg4mm.research.bench.means import scalars
from tg4mm.research.bench.pages.tables import row_name, sets_in
from tg4mm.research.bench.scored import METRICS
from tg4mm.research.evaluate.run import CEILING, STATIC

# Okabe and Ito's colours, told apart by the colour-blind too.
COLOURS = ("#c2500f", "#0072b2", "#009e73", "#cc79a7", "#8a6d00", "#56b4e9", "#5d3a9b", "#7a7f88")
_MARKS = "osD^vP*"  # one fewer than colours, so that no two of many rows look alike
_LEAST, _MOST = -0.5, 1.6  # of closure and gain: one method far off must not press the others together
_SHOWN = ("ssim", "ssim_moving", "closure", "gain")


def over_alpha(results: Mapping[str, Any], group: str) -> str | None:
    """An SVG with four panels, SSIM, SSIM where it moves, closure and gain over α; None where there is no α above 0.

    A curve for each method, means over the sets; what frames them is grey and dashed.
    """
    means = [m for m in results["line_means"] if m["group"] == group]
    alphas = sorted({a for m in means for a in m["alphas"] if float(a) > 0}, key=float)
    if not alphas:
        return None
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 7.4), layout="constrained")
    axes = figure.subplots(2, 2)
    every = sets_in(means)
    own = [m["row"] for m in means if m["row"] not in {STATIC, CEILING}]
    for panel, key in zip(axes.flat, _SHOWN, strict=True):
        for m in means:
            points = [(float(a), v) for a in alphas if (v := m["alphas"].get(a, {}).get(key)) is not None]
            if points:
                panel.plot(*zip(*points, strict=True), label=row_name(m, every), **_style(m["row"], own))
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
    """An SVG as [TG4MM] Fig. 6: size of the model on disk (MiB) against pictures a second; None without any."""
    members = {s["label"] for s in results["sets"] if s["group"] == group}
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
    return {
        "color": COLOURS[i % len(COLOURS)],
        "marker": _MARKS[i % len(_MARKS)],
        "markersize": 4,
        "linewidth": 1.8,
    }


def svg(figure: Any) -> str:
    """The drawing, the same bytes each time."""
    import matplotlib

    with matplotlib.rc_context({"svg.hashsalt": "tg4mm", "svg.fonttype": "none", "font.size": 10}):
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()
