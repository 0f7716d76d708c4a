"""Charts by matplotlib: in files, and as inline SVG whose colours are the page's CSS variables (light and dark).

With its numbers, read from the matplotlib axes, `zoom.js` draws a chart by uPlot so that it zooms. uPlot 1.6.32 (MIT,
`uplot/LICENSE.txt`, https://github.com/leeoniya/uPlot) lies in `uplot/` as its author built it.
"""

import io
import json
import re
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup, escape

from tg4mm.core.colour import amount_colours, hex_colour, phase_colours
from tg4mm.core.digits import nice_ticks, number
from tg4mm.core.files import write_atomic

COLOURS = "#0072b2", "#d55e00", "#009e73"  # Okabe and Ito's, distinguishable for the colour-blind
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "svg.hashsalt": "tg4mm",
    "legend.frameon": False,
}
# Colours that nothing else is drawn in, and the variables that take their places.
INK, MUTED, RULE, OURS, CEILING, STILL, CARD = (f"#0a0b{k:02x}" for k in range(1, 8))
_VARIABLES = {
    INK: "--ink",
    MUTED: "--muted",
    RULE: "--rule",
    OURS: "--ours",
    CEILING: "--ceiling",
    STILL: "--still",
    CARD: "--paper",
    "#777777": "--muted",  # of grey lines in `measure.plots`
    **{colour: f"--axis-{k}" for k, colour in enumerate(COLOURS, 1)},
}
_CONTEXT: dict[Any, Any] = {
    **STYLE,
    "font.size": 11,
    "font.family": "DejaVu Sans",
    "svg.fonttype": "none",
    "text.color": INK,
    "axes.labelcolor": MUTED,
    "axes.edgecolor": MUTED,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "grid.color": STILL,
    "axes.facecolor": "none",
    "figure.facecolor": "none",
    "legend.facecolor": "none",
}
_HERE = Path(__file__).parent
_DIGITS = 6
_COLOURS = 32  # steps of a waterfall's colours


def chart(
    draw: Callable[[Any], None], label: str, size: tuple[float, float] = (5.4, 3.3), zooms: bool = False
) -> Markup:
    """Return an inline SVG of matplotlib axes on which `draw` has drawn, `size` in inches.

    `label` says what it shows to those who do not see it; `zooms`: with its numbers, which a page's script draws anew.
    """
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with matplotlib.rc_context(_CONTEXT):
        figure = Figure(figsize=size, layout="constrained")
        canvas = FigureCanvasSVG(figure)
        draw(figure.subplots())
        for one in figure.axes:
            one.set_title(one.get_title("left"), loc="left", fontsize=9, color=MUTED)
            if (legend := one.get_legend()) is not None:  # over the drawing, not on it
                legend.set_loc("lower right")
                legend.set_bbox_to_anchor((1.0, 1.06), transform=one.transAxes)
        data = io.StringIO()
        canvas.print_svg(data, metadata={"Date": None, "Creator": None})  # `savefig` would draw twice
    numbers = curves(figure.axes[0], _VARIABLES) if zooms else Markup("")
    return _inline(data.getvalue(), label) + numbers


def _inline(text: str, label: str) -> Markup:
    """Return the drawing without the parts of a separate file, with names that no other chart uses."""
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", text, flags=re.S)
    used = set(re.findall(r"(?:url\(|href=\")#([^)\"]+)", text))
    prefix = f"c{zlib.crc32(text.encode()):08x}-"
    text = re.sub(r' id="([^"]*)"', lambda m: f' id="{prefix}{m[1]}"' if m[1] in used else "", text)
    text = re.sub(r"(url\(|href=\")#", rf"\g<1>#{prefix}", text)
    for colour, variable in _VARIABLES.items():
        text = text.replace(colour, f"var({variable})")
    text = re.sub(r"'DejaVu Sans'(?:, [^;\"]*)?", "var(--sans)", text)
    box = re.search(r'viewBox="[^"]*"', text)
    assert box is not None  # matplotlib always gives one
    head = Markup(
        '<svg class="chart drawn" {} role="img" aria-label="{}" xmlns="http://www.w3.org/2000/svg" '
        'xmlns:xlink="http://www.w3.org/1999/xlink">'
    ).format(Markup(box[0]), escape(label))
    body = re.sub(r"\n\s*", "\n", text[text.index(">", text.index("<svg")) + 1 :].strip())
    return head + Markup(body)


def curves(axes: Any, variables: dict[str, str]) -> Markup:
    """A script element of JSON: lines, bands, stems, levels and names of an axes; `variables`: CSS names of colours.

    Curves share their abscissae; where one has no value it is null. A mesh becomes `levels`, 0 … 31, and their colours.
    """
    from matplotlib.collections import LineCollection, PolyCollection, QuadMesh
    from matplotlib.colors import to_hex

    def colour(value: Any) -> str:
        return variables.get(to_hex(value), to_hex(value))

    lines = [line for line in axes.lines if line.get_transform() == axes.transData]
    stems = [c for c in axes.collections if isinstance(c, LineCollection)]
    found = [(np.asarray(n.get_xdata(), float), np.asarray(n.get_ydata(), float)) for n in lines]
    found += [(np.array([s[0, 0] for s in c.get_segments()]), np.array([s[:, 1].max() for s in c.get_segments()]))
              for c in stems]  # fmt: skip
    x = np.unique(np.concatenate([points for points, _ in found])) if found else np.zeros(0)
    series = [
        {"name": _name(line), "colour": colour(line.get_color()), "dash": line.get_linestyle() not in ("-", "None"),
         "points": line.get_linestyle() == "None", "y": _placed(x, *points)}
        for line, points in zip(lines, found, strict=False)
    ]  # fmt: skip
    series += [
        {
            "name": "",
            "colour": colour(np.atleast_2d(c.get_color())[0]),
            "stem": True,
            "y": _placed(x, *points),
        }
        for c, points in zip(stems, found[len(lines) :], strict=True)
        if len(points[0])
    ]
    for band in (c for c in axes.collections if isinstance(c, PolyCollection)):
        points, tone = (
            np.asarray(band.get_paths()[0].vertices),
            colour(np.asarray(band.get_facecolor())[0, :3]),
        )
        of = next(s for s in series if s["colour"] == tone and "low" not in s and not s.get("dash"))
        of["low"], of["high"] = (_placed(x, *_extreme(points, end)) for end in (np.fmin, np.fmax))
    content = {
        "x": _plain(x), "series": series, "xLabel": axes.get_xlabel(), "yLabel": axes.get_ylabel(),
        "xRange": _plain(axes.get_xlim()), "yRange": _plain(axes.get_ylim()), "log": axes.get_yscale() == "log",
        "levels": [_levels(c) for c in axes.collections if isinstance(c, QuadMesh)],
        "across": [[float(n.get_ydata()[0]), colour(n.get_color())] for n in axes.lines
                   if n.get_transform() == axes.get_yaxis_transform()],
        "marks": [[float(t.xy[0]), float(t.xy[1]), t.get_text()] for t in axes.texts
                  if getattr(t, "xycoords", "") == "data"],
    }  # fmt: skip
    for second in axes.child_axes:  # the same lengths in another unit
        content["second"] = [second.get_ylabel(), float(second._functions[0](1.0))]
    text = json.dumps(content, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return Markup('<script type="application/json" class="curves">{}</script>').format(Markup(text))


def zoom_style() -> str:
    """CSS of a page with such charts."""
    return (_HERE / "uplot" / "uPlot.min.css").read_text(encoding="utf-8")


def zoom_script() -> str:
    """JavaScript of a page with such charts."""
    return "".join(
        (_HERE / name).read_text(encoding="utf-8") for name in ("uplot/uPlot.iife.min.js", "zoom.js")
    )


def _name(line: Any) -> str:
    return "" if str(line.get_label()).startswith("_") else str(line.get_label())


def _placed(x: np.ndarray, own_x: np.ndarray, own_y: np.ndarray) -> list[float | None]:
    values = np.full(len(x), np.nan)
    values[np.searchsorted(x, own_x)] = own_y
    return _plain(values)


def _extreme(vertices: np.ndarray, end: Any) -> tuple[np.ndarray, np.ndarray]:
    x, at = np.unique(vertices[:, 0], return_inverse=True)
    y = np.full(len(x), np.nan)
    end.at(y, at, vertices[:, 1])
    return x, y


def _plain(values: Any) -> list[float | None]:
    return [float(f"{v:.{_DIGITS}g}") if np.isfinite(v) else None for v in np.asarray(values, float)]


def _levels(mesh: Any) -> dict[str, Any]:
    from matplotlib.colors import to_hex

    values = mesh.get_array()  # [rows, columns]
    low, high = mesh.get_clim()
    corners = mesh.get_coordinates()
    steps = np.clip((values - low) / ((high - low) or 1.0) * _COLOURS, 0, _COLOURS - 1).astype(int)
    return {
        "x": _plain(corners[0, :, 0]), "y": _plain(corners[:, 0, 1]), "steps": np.asarray(steps).tolist(),
        "limits": [float(low), float(high)],
        "colours": [to_hex(mesh.cmap((k + 0.5) / _COLOURS)) for k in range(_COLOURS)],
    }  # fmt: skip


@contextmanager
def pyplot() -> Iterator[Any]:
    """Yield `matplotlib.pyplot` in the style of the pages."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    with plt.rc_context(STYLE):
        yield plt


def save(plt: Any, figure: Any, paths: Sequence[Path], dpi: int = 120) -> None:
    """Write a figure to the files, PNG or SVG by their suffixes, and close it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    figure.set_dpi(dpi)
    for path in paths:  # `savefig` would draw twice
        if path.suffix.lower() == ".svg":
            write_atomic(path, partial(FigureCanvasSVG(figure).print_svg, metadata={"Date": None}))
        else:
            write_atomic(path, FigureCanvasAgg(figure).print_png)
        figure.set_layout_engine("none")  # the first file has laid it out
    plt.close(figure)


def colour_bar(top: float, unit: str, label: str) -> Markup:
    """A bar of the map for amounts with ticks from 0 to `top`."""
    ticks = [(t / top, number(t)) for t in nice_ticks(0.0, top, 5)] if top > 0 else [(0.0, "0")]
    stops = [(s, hex_colour(amount_colours(np.array(s)))) for s in np.linspace(0, 1, 13)]
    return _bar(stops, ticks, f"{label} ({unit})" if unit else label)


def phase_bar() -> Markup:
    """A bar of the closed colour map with ticks from −180° to 180°."""
    ticks = [((d + 180) / 360, f"{d}°".replace("-", "−")) for d in (-180, -90, 0, 90, 180)]
    stops = [(s, hex_colour(phase_colours(np.array((s - 0.5) * 2 * np.pi)))) for s in np.linspace(0, 1, 25)]
    return _bar(stops, ticks, "phase at timestep 0")


def _bar(stops: list[tuple[float, str]], ticks: list[tuple[float, str]], label: str) -> Markup:
    width, inset = 360, 24
    name = f"g{zlib.crc32(f'{stops}{label}'.encode()):08x}"
    gradient = Markup("").join(
        Markup('<stop offset="{:.3f}" stop-color="{}"/>').format(float(s), colour) for s, colour in stops
    )
    parts = [
        Markup('<defs><linearGradient id="{}">{}</linearGradient></defs>').format(name, gradient),
        Markup('<rect x="{}" y="4" width="{}" height="12" rx="2" fill="url(#{})"/>').format(
            inset, width - 2 * inset, name
        ),
    ]
    for share, text in ticks:
        x = inset + share * (width - 2 * inset)
        parts += [_line(x, 16, x, 21, "rule"), _text(x, 34, text, "middle")]
    parts.append(_text(width / 2, 52, label, "middle", "axis"))
    body = Markup("").join(parts)
    return Markup('<svg class="colourbar" viewBox="0 0 {} 58" role="img" aria-label="{}">{}</svg>').format(
        width, label, body
    )


def _line(x1: float, y1: float, x2: float, y2: float, style: str) -> Markup:
    return Markup('<line class="line-{}" x1="{:.1f}" y1="{:.1f}" x2="{:.1f}" y2="{:.1f}"/>').format(
        style, x1, y1, x2, y2
    )


def _text(x: float, y: float, text: str, anchor: str, style: str = "tick") -> Markup:
    return Markup('<text class="{}" x="{:.1f}" y="{:.1f}" text-anchor="{}">{}</text>').format(
        style, x, y, anchor, text
    )
