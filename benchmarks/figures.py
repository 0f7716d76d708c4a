"""The figures of README.md and docs/results.md: all their tables of the benchmark are written from docs/figures.json.

    python -m benchmarks figures                             # writes the tables anew
    python -m benchmarks figures --results eight.json --five small.json --mic mic.json    # takes these first

A table stands between `<!-- figures: NAME -->` and `<!-- end -->`.
"""

import argparse
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.figures_tables import (
    five_tables,
    merged,
    mic_table,
    number,
    rivals_tables,
    splits_tables,
)
from tg4mm.core.errors import Tg4mmError
from tg4mm.research.bench.means import half_width

ROOT = Path(__file__).parents[1]
FILE = ROOT / "docs" / "figures.json"
PAGES = (ROOT / "README.md", ROOT / "docs" / "results.md")
OPTIONS = {
    "--results": "",
    "--five": "",
    "--mic": "",
    "--rivals": "",
    "--dev": "",
    "--test": "",
}
# of the motion, by key of `means.scalars`: title, format, factor
_MOTION = {
    "displacement_error": ("error, %", "{:.1f}", 100),
    "displacement_error_observed": ("of what can be observed, %", "{:.1f}", 100),
    "static_leak": ("leak, %", "{:.1f}", 100),
    "amplitude_ratio": ("amplitude ratio", "{:.3f}", 1),
    "direction_error_deg": ("direction off, °", "{:.1f}", 1),
    "mac": ("MAC", "{:.3f}", 1),
}
_ROWS = ("nothing moves", "modal", "ceiling")
_LOST_AT = ("20", "50")  # α


def figures_of(results: Mapping[str, Any]) -> dict[str, Any]:
    """Return the figures of a benchmark's results.json.

    {scenes: {name: {key: figure}}, ssim: {row: {α: mean}}, of `modal`.
    """
    from tg4mm.research.bench.means import scalars

    runs = {run["set"].partition("_")[0]: scalars(run) for run in results["runs"] if run["row"] == "modal"}
    means = {m["row"]: m["alphas"] for m in results["line_means"] if m["row"] in _ROWS}
    return {
        "scenes": {name: {key: values[key] for key in _MOTION} for name, values in runs.items()},
        "ssim": {row: {a: scores["ssim"] for a, scores in means[row].items()} for row in _ROWS},
    }


def tables(figures: Mapping[str, Any]) -> dict[str, str]:
    """{name: Markdown}: every scene, SSIM over α, and the short table of README."""
    scenes, ssim = figures["scenes"], figures["ssim"]
    mean = {key: sum(values[key] for values in scenes.values()) / len(scenes) for key in _MOTION}
    half = {key: half_width([values[key] for values in scenes.values()], list(scenes)) for key in _MOTION}
    motion = [
        [name, *(number(form, values[key] * factor) for key, (_, form, factor) in _MOTION.items())]
        for name, values in scenes.items()
    ]
    means = (
        number(form, mean[key] * factor, None if (h := half[key]) is None else h * factor)
        for key, (_, form, factor) in _MOTION.items()
    )
    motion.append(["mean", *means])
    named = {"modal": "`modal`"}
    scores = [
        [named.get(row, row), *(number("{:.4f}", v) for v in values.values())] for row, values in ssim.items()
    ]
    lost = [number("{:.4f}", ssim["ceiling"][a] - ssim["modal"][a]) for a in _LOST_AT]
    errors = {name: values["displacement_error"] for name, values in scenes.items()}
    best, worst = min(errors, key=errors.__getitem__), max(errors, key=errors.__getitem__)
    why = f": {note}" if (note := figures.get("notes", {}).get(worst)) else ""
    cells = (
        f"{100 * mean['displacement_error']:.0f} ± {100 * (half['displacement_error'] or 0):.0f} %",
        f"{100 * errors[best]:.0f} % ({best})",
        f"{100 * errors[worst]:.0f} % ({worst}{why})",
    )
    others = {name: _markdown(made["header"], made["rows"]) for name, made in figures["tables"].items()}
    return others | {
        "scenes": _markdown(["set", *(title for title, _, _ in _MOTION.values())], motion),
        "ssim": _markdown(["SSIM, mean", *(f"α = {a}" for a in next(iter(ssim.values())))], scores),
        "short": "\n".join(
            [
                "| eight generated scenes, 128×128, 30 cameras, 0.2 pixels of motion "
                "| mean, ± 95 % over scenes | best | worst |",
                "|---|---:|---:|---:|",
                f"| displacement error, rms, relative to the true motion | {' | '.join(cells)} |",
                f"| SSIM lost against the exact motion, α = {' / '.join(_LOST_AT)} | {' / '.join(lost)} | | |",
            ]
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
    if options.five:
        figures["tables"] |= five_tables(_read(options.five))
    if options.mic:
        figures["tables"] |= mic_table(_read(options.mic))
    if options.rivals:  # of a part of the sets and methods the rest stays
        figures["tables"] = merged(figures["tables"], rivals_tables(_read(options.rivals)))
    if options.dev and options.test:
        splits = {"small-dev": _read(options.dev), "small-test": _read(options.test)}
        figures["tables"] |= splits_tables(splits)
    FILE.write_text(json.dumps(figures, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    for page in PAGES:
        page.write_text(filled(page.read_text(encoding="utf-8"), tables(figures)), encoding="utf-8")
        print(page)
