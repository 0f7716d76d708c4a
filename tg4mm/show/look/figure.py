"""The picture of a look: regions on the first picture, and the composite spectrum beside them."""

import io
from functools import partial
from pathlib import Path

import numpy as np

from tg4mm.capture.look import Look
from tg4mm.core.files import write_atomic
from tg4mm.core.pages.plotstyle import STYLE
from tg4mm.show.look.words import Words
from tg4mm.show.regions import composite, region_picture

_WIDTH, _HEIGHT = 13.0, 5.0  # inches
_DPI = 110


def write_picture(words: Words, path: Path) -> None:
    """A PNG of it."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    found = words.found
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(_WIDTH, _HEIGHT), layout="constrained")
        FigureCanvasAgg(figure)
        seen, spectrum = figure.subplots(1, 2, width_ratios=_ratios(found))
        seen.imshow(regions_on_first(found), extent=(0, found.size[0], found.size[1], 0))
        seen.set(xlabel="pixels", ylabel="pixels")
        seen.grid(visible=False)
        composite(spectrum, found)
        figure.suptitle(f"{words.source.name}: {words.verdict}", x=0.01, ha="left", weight="bold")
        data = io.BytesIO()
        figure.savefig(data, format="png", dpi=_DPI)
    write_atomic(path, partial(Path.write_bytes, data=data.getvalue()))


def regions_on_first(found: Look) -> np.ndarray:
    """[H, W, 3] uint8."""
    return region_picture(found, np.repeat(found.first[..., None], 3, 2))


def _ratios(found: Look) -> tuple[float, float]:
    """Widths of both parts, so that the picture fills its own."""
    share = min(max(found.size[0] / found.size[1] * _HEIGHT * 0.8 / _WIDTH, 0.25), 0.6)
    return share, 1 - share
