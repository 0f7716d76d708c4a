"""Charts by matplotlib as inline SVG whose colours are the page's CSS variables, so that they follow light and dark."""

import io
import re
import zlib
from collections.abc import Callable
from typing import Any

from markupsafe import Markup, escape

from tg4mm.core.pages.curves import curves
from tg4mm.core.pages.plotstyle import COLOURS, STYLE

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


def chart(
    draw: Callable[[Any], None], label: str, size: tuple[float, float] = (5.4, 3.3), zooms: bool = False
) -> Markup:
    """An inline SVG of what `draw` puts on a matplotlib axes, `size` in inches.

    `label` says what it shows to those who do not see it; `zooms`: with its numbers, which a page's script draws anew.
    """
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with matplotlib.rc_context(_CONTEXT):
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasSVG(figure)
        draw(figure.subplots())
        for one in figure.axes:
            one.set_title(one.get_title("left"), loc="left", fontsize=9, color=MUTED)
            if (legend := one.get_legend()) is not None:  # over the drawing, not on it
                legend.set_loc("lower right")
                legend.set_bbox_to_anchor((1.0, 1.06), transform=one.transAxes)
        data = io.StringIO()
        figure.savefig(data, format="svg", metadata={"Date": None, "Creator": None})
    numbers = curves(figure.axes[0], _VARIABLES) if zooms else Markup("")
    return _inline(data.getvalue(), label) + numbers


def _inline(text: str, label: str) -> Markup:
    """The drawing alone, without what belongs to a file of its own; names do not clash with another chart's."""
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", text, flags=re.S)
    used = set(re.findall(r"(?:url\(|href=\")#([^)\"]+)", text))
    own = f"c{zlib.crc32(text.encode()):08x}-"
    text = re.sub(r' id="([^"]*)"', lambda m: f' id="{own}{m[1]}"' if m[1] in used else "", text)
    text = re.sub(r"(url\(|href=\")#", rf"\g<1>#{own}", text)
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
