"""The page of a look: one HTML file that needs no network."""

from functools import partial
from pathlib import Path

import numpy as np

from tg4mm.capture.look import Look
from tg4mm.core import __version__
from tg4mm.core.files import write_atomic
from tg4mm.core.pages.charts import chart
from tg4mm.core.pages.page import (
    Block,
    Commands,
    Figure,
    Page,
    Section,
    Stat,
    Table,
    Text,
    drawing,
    picture,
    render_page,
)
from tg4mm.show.look.words import HEADER, Words
from tg4mm.show.plotting import pyplot, save
from tg4mm.show.regions import composite, region_picture

_STYLE = ".left2 td:last-child { white-space: normal; }"


def write_page(words: Words, path: Path) -> None:
    """What was found, where, and what to do next."""
    found = words.found
    seen = Figure(
        [picture(regions_on_first(found), alt="what vibrates and what moves by itself", photo=True)],
        "The first picture. Coloured: cells that show a vibration, and its direction; the first colour is the "
        "strongest. Striped: what moves by itself and is masked. White frames: that, and where something passes.",
    )
    spectrum = Figure(
        [
            drawing(
                chart(partial(composite, found=found), "composite spectrum over all cells", (6.6, 3.0), True)
            )
        ],
        "Composite spectrum: power over noise, mean over all cells; 1 where nothing vibrates. Dashed: what noise alone "
        "exceeds anywhere in one recording of a hundred. Dotted: lines of the light.",
        width="narrow",
    )
    lines: list[Block] = [Text(words.verdict[0].upper() + words.verdict[1:] + ".")]
    if rows := words.rows():
        caption = (
            "Amplitudes are zero to peak, the largest of the record, in pixels along the direction; ± is one standard "
            "deviation. A remark says why a line may be none of its own, or larger than said."
        )
        lines = [Table(HEADER, rows, caption, left=len(HEADER))]
    drawn: list[Section] = []
    if own := words.region_rows():
        header = tuple(words.region_header())
        drawn = [
            Section(
                "Regions", [Table(header, own, "Lines of the mean shift of each region.", left=len(header))]
            )
        ]
    besides = Table(
        ("", ""),
        [[what, text] for what, text in words.besides()],
        "Other findings, and what could not be determined.",
        left=2,
    )
    page = Page(
        title=words.source.name,
        kicker="tg4mm look",
        summary=f"{words.verdict[0].upper()}{words.verdict[1:]}.",
        stats=_stats(words),
        lead=[seen],
        sections=[
            Section("Vibrations", [*lines, spectrum]),
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
    if found.vibrations:
        first = found.vibrations[0]
        out = [
            Stat("strongest", f"{first.hz:.4g}", "Hz", f"± {first.hz_deviation:.2g}"),
            Stat(
                "its amplitude",
                f"{'> ' if first.lost else ''}{first.amplitude_px:.3g}",
                "px",
                f"± {first.amplitude_deviation_px:.2g}",
            ),
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
    """[H, W, 3] uint8."""
    return region_picture(found, np.repeat(found.first[..., None], 3, 2))


def _ratios(found: Look) -> tuple[float, float]:
    """Widths of both parts, so that the picture fills its own."""
    share = min(max(found.size[0] / found.size[1] * _HEIGHT * 0.8 / _WIDTH, 0.25), 0.6)
    return share, 1 - share
