"""The page of a look: one HTML file that needs no network."""

from pathlib import Path

import numpy as np

from tg4mm.capture.look import Look
from tg4mm.core import __version__
from tg4mm.core.files import write_atomic
from tg4mm.core.pages.page import (
    Block,
    Commands,
    Figure,
    Page,
    Section,
    Stat,
    Table,
    Text,
    picture,
    render_page,
)
from tg4mm.show.look.words import HEADER, Words
from tg4mm.show.plotting import pyplot, save
from tg4mm.show.regions import REGIONS_ALT, composite, composite_figure, region_picture

_STYLE = ".left2 td:last-child { white-space: normal; }"


def write_page(words: Words, path: Path) -> None:
    """Write the page with vibrations, their positions, and next commands."""
    found, summary = words.found, f"{words.verdict[0].upper()}{words.verdict[1:]}."
    seen = Figure(
        [picture(regions_on_first(found), alt=REGIONS_ALT, photo=True)],
        "The first picture. Coloured: cells that show a vibration, and its direction; the first colour is the "
        "strongest. Striped: independent motion, which is masked. White frames: that, and passing objects.",
    )
    lines: list[Block] = [Text(summary)]
    if rows := words.rows():
        caption = (
            "Amplitudes are zero to peak, the largest of the record, in pixels along the direction; ± is one standard "
            "deviation. A remark says why a line may be an artefact, or larger than stated."
        )
        lines = [Table(HEADER, rows, caption, left=len(HEADER))]
    drawn: list[Section] = []
    if own := words.region_rows():
        header = tuple(words.region_header())
        table = Table(header, own, "Lines of the mean shift of each region.", left=len(header))
        drawn = [Section("Regions", [table])]
    others = [[what, text] for what, text in words.besides()]
    besides = Table(("", ""), others, "Other findings, and what could not be determined.", left=2)
    page = Page(
        title=words.source.name,
        kicker="tg4mm look",
        summary=summary,
        stats=_stats(words),
        lead=[seen],
        sections=[
            Section("Vibrations", [*lines, composite_figure(found)]),
            *drawn,
            Section("Beside them", [besides]),
            Section("Go on", [Commands([(what, command) for command, what in words.commands()])]),
        ],
        footer=f"tg4mm {__version__}; {words.head}",
    )
    write_atomic(path, lambda unfinished: unfinished.write_text(render_page(page, _STYLE), encoding="utf-8"))


def _stats(words: Words) -> list[Stat]:
    found = words.found
    out = []
    for first in found.vibrations[:1]:
        size = f"{'> ' if first.lost else ''}{first.amplitude_px:.3g}"
        out = [
            Stat("strongest", f"{first.hz:.4g}", "Hz", f"± {first.hz_deviation:.2g}"),
            Stat("its amplitude", size, "px", f"± {first.amplitude_deviation_px:.2g}"),
        ]
    out.append(Stat("record", f"{found.duration_s:.3g}", "s", f"at {found.rate:.4g} Hz"))
    if found.smallest:
        least = found.smallest[min(2, len(found.smallest) - 1)]
        out.append(Stat("smallest motion", f"{least.amplitude_px:.2g}", "px", f"{least.across_px} px across"))
    return out


_WIDTH, _HEIGHT = 13.0, 5.0  # inches
_DPI = 110


def write_picture(words: Words, path: Path) -> None:
    """Write a PNG of the regions on the first picture and the composite spectrum."""
    found = words.found
    with pyplot() as plt:
        figure = plt.figure(figsize=(_WIDTH, _HEIGHT), layout="constrained")
        seen, spectrum = figure.subplots(1, 2, width_ratios=_ratios(found))
        seen.imshow(regions_on_first(found), extent=(0, found.size[0], found.size[1], 0))
        seen.set(xlabel="pixels", ylabel="pixels")
        seen.grid(visible=False)
        composite(spectrum, found)
        figure.suptitle(f"{words.source.name}: {words.verdict}", x=0.01, ha="left", weight="bold")
        save(plt, figure, [path], _DPI)


def regions_on_first(found: Look) -> np.ndarray:
    """Return the first picture [H, W, 3] uint8 with the regions on it."""
    return region_picture(found, np.repeat(found.first[..., None], 3, 2))


def _ratios(found: Look) -> tuple[float, float]:
    """Return the widths of both parts, so that the picture fills its part."""
    share = min(max(found.size[0] / found.size[1] * _HEIGHT * 0.8 / _WIDTH, 0.25), 0.6)
    return share, 1 - share
