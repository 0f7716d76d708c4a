"""How time, memory and error of `modal` grow with pixels, Gaussians and timesteps, with fitted exponents.

    python -m benchmarks scaling OUT [--scene mic] [--views 8] [--samples 8]

Renders the sets, trains each in a process of its own, and writes OUT/scaling.json, scaling.md and scaling.svg. Done
again it goes on where it was. An exponent b is that of y ∝ x^b, by least squares on logarithms, ± its standard error
from the residuals. Seconds are of the processor. Run it with OMP_NUM_THREADS=1.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.common import machine
from tg4mm.core.errors import Tg4mmError

OPTIONS = {"out": Path, "--scene": "mic", "--views": 8, "--samples": 8}
_SIZE, _TIMESTEPS, _MOST = (
    96,
    30,
    4000,
)  # what holds where it is not varied: pixels along an edge, timesteps, Gaussians
VARIED = {
    "pixels": (68, 96, 136, 192, 272),  # along an edge; a picture has the square
    "Gaussians": (500, 1000, 2000, 4000, 8000),
    "timesteps": (15, 30, 60, 120),
}
MEASURED = {
    "space_s": "space, s", "motion_s": "motion, s", "space_peak_mib": "space, peak MiB",
    "motion_peak_mib": "motion, peak MiB", "displacement_error": "displacement error",
}  # fmt: skip
_PANELS = {"seconds": ("space_s", "motion_s"), "peak MiB": ("space_peak_mib", "motion_peak_mib"),
           "displacement error": ("displacement_error",)}  # fmt: skip


# The clock that stages are timed by is the processor's: other work beside it does not count.
_PROGRAM = """
import sys, time
time.monotonic = time.process_time
from tg4mm.cli import main
sys.exit(main(sys.argv[1:]))
"""


def fitted(x: Sequence[float], y: Sequence[float]) -> tuple[float, float]:
    """(exponent b of y ∝ x^b, its standard error) of three points or more, all above 0."""
    if len(x) < 3 or min(*x, *y) <= 0:
        raise ValueError(f"{len(x)} points, expected 3 or more, all above 0")
    (b, _), covariance = np.polyfit(np.log(x), np.log(y), 1, cov=True)
    return float(b), float(np.sqrt(covariance[0, 0]))


def measured(options: argparse.Namespace, varied: str, value: int) -> dict[str, float]:
    """{"x": pixels of a picture, Gaussians that there are, or timesteps; and what `MEASURED` names}."""
    out = Path(options.out)
    size = value if varied == "pixels" else _SIZE
    timesteps = value if varied == "timesteps" else _TIMESTEPS
    data, place = out / "data" / f"{size}_{timesteps}", out / "bench" / f"{varied}_{value}"
    _run("generate", options.scene, "--out", data, "--size", size, "--timesteps", timesteps, "--views", options.views,
         "--test-views", 1, "--samples", options.samples, "--alphas", 20, "--truth", "none")  # fmt: skip
    (root,) = data.iterdir()
    most = value if varied == "Gaussians" else _MOST
    _run(
        "bench", "scenes", root, "--methods", "modal", "--out", place, "--set", f"space.max_gaussians={most}"
    )
    from tg4mm.research.bench.means import scalars

    (run,) = json.loads((place / "results.json").read_text(encoding="utf-8"))["runs"]
    known = scalars(run)
    x = {"pixels": size**2, "Gaussians": known["n_gaussians"], "timesteps": timesteps}[varied]
    return {"x": float(x or 0), **{key: float(known[key] or 0) for key in MEASURED}}


def _run(*arguments: object) -> None:
    command = [sys.executable, "-c", _PROGRAM, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise Tg4mmError((done.stderr.strip() or f"{command} failed").splitlines()[-1])


def exponents(points: Sequence[Mapping[str, float]]) -> dict[str, tuple[float, float]]:
    """{measured: (exponent, standard error)} over the points of one axis."""
    x = [point["x"] for point in points]
    return {key: fitted(x, [point[key] for point in points]) for key in MEASURED}


def drawn(found: Mapping[str, Sequence[Mapping[str, float]]]) -> str:
    """An SVG: a row of panels for each axis, both axes logarithmic, the fit dashed, its exponent in the legend."""
    from matplotlib.figure import Figure

    from tg4mm.research.bench.pages.plots import COLOURS, svg

    figure = Figure(figsize=(11, 3.2 * len(found)), layout="constrained")
    for row, (varied, points) in zip(
        figure.subplots(len(found), len(_PANELS), squeeze=False), found.items(), strict=True
    ):
        x, slopes = np.array([point["x"] for point in points]), exponents(points)
        for panel, (title, keys) in zip(row, _PANELS.items(), strict=True):
            for colour, key in zip(COLOURS, keys, strict=False):
                y = np.array([point[key] for point in points])
                b, error = slopes[key]
                name = "" if key == "displacement_error" else f"{key.partition('_')[0]}: "
                panel.loglog(x, y, "o", color=colour, label=f"{name}{b:.2f} ± {error:.2f}")
                panel.loglog(
                    x, np.exp(np.log(y).mean()) * (x / np.exp(np.log(x).mean())) ** b, "--", color=colour
                )
            panel.set_xlabel(f"{varied} of a picture" if varied == "pixels" else varied)
            panel.set_ylabel(title)
            panel.set_xticks(x[::2], [f"{value:,.0f}" for value in x[::2]], minor=False)
            panel.set_xticks([], minor=True)
            for formatted in (panel.yaxis.set_major_formatter, panel.yaxis.set_minor_formatter):
                formatted("{x:g}")
            panel.grid(alpha=0.25)
            panel.legend(frameon=False)
    return svg(figure)


def table_of(found: Mapping[str, Sequence[Mapping[str, float]]]) -> str:
    """Markdown: exponents, a row for each axis, with the range it was varied in."""
    from tg4mm.research.text import table

    rows = []
    for varied, points in found.items():
        ends = f"{points[0]['x']:,.0f} to {points[-1]['x']:,.0f}"
        rows.append([varied, ends, *(f"{b:.2f} ± {error:.2f}" for b, error in exponents(points).values())])
    return table(["grows with", "range", *MEASURED.values()], rows, text_columns=2)


def run(options: argparse.Namespace) -> None:
    found: dict[str, list[dict[str, float]]] = {}
    for varied, values in VARIED.items():
        for value in values:
            found.setdefault(varied, []).append(measured(options, varied, value))
            print(varied, json.dumps(found[varied][-1]), flush=True)
    out = Path(options.out)
    (out / "scaling.json").write_text(
        json.dumps({"made": machine(), "points": found}, indent=1) + "\n", encoding="utf-8"
    )
    (out / "scaling.md").write_text(table_of(found) + "\n", encoding="utf-8")
    (out / "scaling.svg").write_text(drawn(found), encoding="utf-8")
    print(table_of(found))
