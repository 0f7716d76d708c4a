"""Charts of the benchmark as SVG files that stand alone: drawn by `tg4mm.report.svg`, with their colours inside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tg4mm.report.svg import HEIGHT, WIDTH, Series, below, score_chart

# Okabe and Ito's colours, told apart by the colour-blind too; in a dark page's frame they stay readable.
_PALETTE = ("#c2500f", "#0072b2", "#009e73", "#cc79a7", "#8a6d00", "#56b4e9", "#5d3a9b", "#7a7f88")
_STYLES = tuple(f"s{i}" for i in range(len(_PALETTE)))
_REST = "rest"  # what nothing moves and the ceiling are drawn in
_GREY = "#9aa0a8"
_ROOM = 125  # units that a chart leaves for the labels at its right end
_WIDEST = 8.6  # units that a character of a label takes, in the widest of the fonts


def curves(
    x_names: Sequence[str],
    series: Mapping[str, Sequence[float | None]],
    x: str,
    y: str,
    breaks: Sequence[int] = (),
) -> str:
    """An SVG file with one labelled curve per entry; "nothing moves" and "ceiling" are grey.

    breaks: positions that no line leads to from the one before.
    """
    styles = iter(_STYLES * (len(series) // len(_STYLES) + 1))
    drawn = [
        Series(
            name,
            list(values),
            _REST if name.startswith(("nothing moves", "ceiling")) else next(styles),
            breaks,
        )
        for name, values in series.items()
    ]
    longest = max((len(name) for name in series), default=0)
    wider = max(0, round(_WIDEST * longest) - _ROOM)
    return standalone(score_chart(x_names, drawn, x, y), wider, below(len(series)))


def standalone(svg: Any, wider: int = 0, taller: int = 0) -> str:
    """A chart of `tg4mm.report.svg` as a file of its own, on white, so that it reads on any page.

    wider, taller: units of room at the right and below, for labels that are long or many.
    """
    head, _, body = str(svg).partition(">")
    width = WIDTH + wider
    head = head.replace(f"0 0 {WIDTH} {HEIGHT}", f"0 0 {width} {HEIGHT + taller}").replace(
        "<svg", f'<svg xmlns="http://www.w3.org/2000/svg" width="{round(1.25 * width)}"', 1
    )
    return f'{head}><style>{_css()}</style><rect width="100%" height="100%" fill="#ffffff"/>{body}\n'


def _css() -> str:
    rules = [
        "text{font-family:Inter,'Segoe UI',Roboto,Helvetica,Arial,sans-serif;font-size:13px;fill:#1b1d21}",
        "text.tick,text.axis{fill:#5f646c;font-size:12.5px}",
        ".line-rule{stroke:#e3e0d8;stroke-width:1}",
        "polyline{fill:none;stroke-width:2.2;stroke-linejoin:round}",
    ]
    for style, colour in zip((*_STYLES, _REST), (*_PALETTE, _GREY), strict=True):
        rules.append(f".line-{style}{{stroke:{colour}}}.fill-{style}{{fill:{colour}}}")
        rules.append(f"text.label-{style}{{fill:{colour};font-weight:600}}")
    return "".join(rules)
