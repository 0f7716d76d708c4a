"""The result of a look at a recording: in words for the terminal, as a picture, a page and a JSON file."""

import math
import shlex
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture.duplicates import OFF
from tg4mm.capture.look import Look, LookLine, MovingRegion
from tg4mm.capture.look.peaks import LOWEST
from tg4mm.capture.look.record import to_record
from tg4mm.capture.look.rows import row_note
from tg4mm.capture.look.zoom import swing_note
from tg4mm.capture.sfm.clip import WHOLE, TimeWindow, uneven_steps
from tg4mm.core import __version__
from tg4mm.core.digits import aligned, value_with_deviation
from tg4mm.core.files import argument, write_atomic, write_json
from tg4mm.core.pages.charts import pyplot, save
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
from tg4mm.core.regions import Region, Regions
from tg4mm.show.regions import REGIONS_ALT, composite, composite_figure, region_picture

HEADER = ("frequency, Hz", "amplitude, px", "direction", "around pixel", "change", "remark")
_MOST_MOVERS = 5  # that are listed
_MOVES_PX = 1.0  # motion of the complete picture from which the shift of a cell is not exact
_TEXTURE = 0.25  # share of cells that must have texture
_CHANGES = {
    "steady": "steady",
    "grows": "grows",
    "decays": "rings down",
    "begins": "begins at {start:.2f} s",
    "varies": "varies",
    "untold": "too faint to tell",
}
_STYLE = ".left2 td:last-child { white-space: normal; }"
_WIDTH, _HEIGHT = 13.0, 5.0  # inches
_DPI = 110


@dataclass(frozen=True)
class LookText:
    """The parts of the text about a recording."""

    found: Look
    source: Path
    fps: float | None = None  # as requested
    window: TimeWindow = WHOLE
    drawn: Regions | None = None
    drawn_file: Path | None = None
    keep_duplicates: bool = False

    @property
    def head(self) -> str:
        """Number, size and rate of the recording's pictures."""
        f = self.found
        return (
            f"{self.source}: {len(f.times_s)} pictures of {f.size[0]}×{f.size[1]} at {f.rate:.4g} Hz, "
            f"{f.duration_s:.3g} s; cells of {f.cell_px} px"
        )

    @property
    def verdict(self) -> str:
        """A sentence on the strongest vibration, or on its absence."""
        lines = self.found.vibrations
        if not lines:
            return "no vibration stands out of the noise"
        first = lines[0]
        many = f"{len(lines)} vibrations; the strongest" if len(lines) > 1 else "one vibration"
        hz = value_with_deviation(first.hz, first.hz_deviation)
        return f"{many}: {hz} Hz, {_amplitude(first)} px at {_at(first)}"

    def rows(self) -> list[list[str]]:
        """Return the table's rows, under HEADER."""
        return [_row(line) for line in self.found.lines]

    def region_rows(self) -> list[list[str]]:
        """Return the rows of drawn regions, under `region_header`, including regions without vibrations."""
        out = []
        for one in self.found.regions:
            for k, line in enumerate(one.lines):
                row = _row(line)
                row[3:4] = self._metric(one.region, line)
                row[-1] = "; ".join(filter(None, [row[-1], "" if k else one.remark]))
                out.append(["" if k else one.region.name, *row])
            if not one.lines:
                last = "; ".join(
                    filter(None, [f"no line; a picture's shift ± {one.noise_px:.2g} px", one.remark])
                )
                out.append([one.region.name, "none", *[""] * (len(self.region_header()) - 3), last])
        return out

    def region_header(self) -> list[str]:
        """Return the head of `region_rows`, with lengths and velocity if there is a scale."""
        metric = ["amplitude, mm", "mm/s rms"] if self.drawn is not None and self.drawn.scale else []
        return ["region", *HEADER[:3], *metric, *HEADER[4:]]

    def _metric(self, region: Region, line: LookLine) -> list[str]:
        if self.drawn is None or self.drawn.scale is None:
            return []
        along = float(np.linalg.norm(self.drawn.scale.metres_at(region.centre) @ line.direction)) * 1e3
        sure = float(np.hypot(line.amplitude_deviation_px, self.drawn.scale.share * line.amplitude_px))
        mark, speed = "> " if line.lost else "", along * 2 * math.pi * line.hz / math.sqrt(2)
        return [mark + value_with_deviation(each * line.amplitude_px, each * sure) for each in (along, speed)]

    def besides(self) -> list[tuple[str, str]]:
        """Return (title, text) of everything but the lines and the next command."""
        f = self.found
        out = [("pictures", f.conversion)] if f.conversion else []
        out += [("moves by itself", _mover(m)) for m in f.movers[:_MOST_MOVERS]]
        if more := len(f.movers) - _MOST_MOVERS:
            out += [("", f"{more} more places")] if more > 0 else []
        out += [
            (
                "light",
                f"flickers at {value_with_deviation(t.hz, t.hz_deviation)} Hz, by {100 * t.amplitude:.2g} %",
            )
            for t in f.light
        ]
        out += [
            (
                "whole picture",
                f"moves at {value_with_deviation(t.hz, t.hz_deviation)} Hz by {t.amplitude:.2g} px",
            )
            for t in f.whole
        ]
        out += [("light" if s.kind == "light" else "whole picture", swing_note(s, f.size)) for s in f.swings]
        out += [("smallest motion", text) for text in self._smallest()]
        return out + [("cannot tell", text) for text in self.cannot()]

    def _smallest(self) -> list[str]:
        parts = [
            f"{s.amplitude_px:.2g} px ({s.best_px:.2g} where texture is best) of something {s.across_px} px across"
            for s in self.found.smallest[::2]
        ]
        return [f"a steady vibration is found from about {', '.join(parts)}"] if parts else []

    def cannot(self) -> list[str]:
        """Return the quantities that this recording cannot show."""
        f = self.found
        half = f.rate / 2
        out = [
            f"frequencies above {half:.4g} Hz from lower ones: they appear at aliases, |k × {f.rate:.4g} Hz ± f|",
            f"frequencies below {LOWEST / f.duration_s:.2g} Hz, and two that are closer than "
            f"{1 / f.duration_s:.2g} Hz: the record covers {f.duration_s:.3g} s",
        ]
        if f.images_hz and f.lines:
            out.append(
                f"vibrations at |k × {f.images_hz:.4g} Hz ± f| beside one at f: the order of B-frames makes images "
                "of it there"
            )
        if f.repeats:
            out.append(
                f"anything by {len(f.repeats)} duplicate frames: they are left out, and others get corrected times; "
                f"{OFF} keeps all"
            )
        elif steps := uneven_steps(f.times_s):
            out.append(
                f"times better than the file: the frame rate varies, with steps of {1e3 * steps[0]:.3g} to "
                f"{1e3 * steps[1]:.3g} ms; each picture keeps its own time"
            )
        if f.light:
            out.append("faint vibrations at the frequencies of the light")
        reach = float(np.ptp(f.whole_px, axis=0).max()) if len(f.whole_px) else 0.0
        if reach > _MOVES_PX:
            out.append(
                f"amplitudes exactly: the camera itself moved by {reach:.1f} px; put it on a tripod, or use "
                "tg4mm sfm --kind handheld"
            )
        if (share := float(f.usable.mean())) < _TEXTURE:
            out.append(f"motion where there is no texture: {share:.0%} of the picture can be used")
        return out + [note for note in [row_note(f)] if note]

    def commands(self) -> list[tuple[str, str]]:
        """Return next commands and their effects."""
        name = shlex.quote(self.source.stem)
        options = f" --fps {self.fps:g}" if self.fps is not None else ""
        options += f" --readout {1e3 * self.found.rows_s:g}" if self.found.rows_s else ""
        options += f" {OFF}" if self.keep_duplicates else ""
        options += f" --from {self.window.start_s:g}" if self.window.start_s else ""
        options += f" --until {self.window.stop_s:g}" if math.isfinite(self.window.stop_s) else ""
        options += f" --regions {argument(self.drawn_file)}" if self.drawn_file is not None else ""
        if not self.found.vibrations:
            return [
                (
                    f"tg4mm look LONGER{self.source.suffix}",
                    "film longer, closer or with more light, and look again",
                )
            ]
        return [
            (
                f"tg4mm process {argument(self.source)} --kind flat{options} --out {name}-out",
                "numbers of each part, a magnified video, pages",
            )
        ]

    def lines(self) -> list[str]:
        """Return all parts as lines of text."""
        out = [self.head]
        for header, rows in ((list(HEADER), self.rows()), (self.region_header(), self.region_rows())):
            out += [f"  {line}" for line in aligned([header, *rows])] if rows else []
        if not self.found.vibrations:
            out.append(f"  {self.verdict}")
        last = ""
        for what, text in self.besides():
            out.append(f"  {'' if what == last else what:<17}{text}")
            last = what
        return [*out, f"  {'next':<17}{' && '.join(command for command, _ in self.commands())}"]


def _row(line: LookLine) -> list[str]:
    right, down = line.direction
    if (abs(down) > abs(right) and down > 0) or (abs(right) >= abs(down) and right < 0):
        right, down = -right, -down
    change = _CHANGES.get(line.change, line.change).format(start=line.start_s or 0.0)
    if line.damping is not None:
        percent = None if line.damping_deviation is None else 100 * line.damping_deviation
        change += f", damping {value_with_deviation(100 * line.damping, percent)} %"
    return [
        value_with_deviation(line.hz, line.hz_deviation),
        _amplitude(line),
        f"{right:+.2f} right {-down:+.2f} up".replace("-", "−"),
        _at(line),
        change,
        line.mark or line.lost,
    ]


def _amplitude(line: LookLine) -> str:
    """Return `0.12 ± 0.01`, or `> 0.12 ± 0.01` if compression removed more than the ± states."""
    return ("> " if line.lost else "") + value_with_deviation(line.amplitude_px, line.amplitude_deviation_px)


def _at(line: LookLine) -> str:
    return f"({line.centre_px[0]:.0f}, {line.centre_px[1]:.0f})"


def _mover(mover: MovingRegion) -> str:
    left, upper, right, lower = mover.box
    where = f"({left}, {upper}) to ({right}, {lower})"
    if mover.kind == "passes":
        return f"{where}: something passes, {mover.from_s:.1f} to {mover.until_s:.1f} s; masked meanwhile"
    rate = "" if mover.hz is None else f", periodically at {mover.hz:.4g} Hz or an alias of it"
    return f"{where}{rate}; masked"


def write_json_file(words: LookText, path: Path) -> None:
    """Return all results: pixels, Hz, seconds; cells by number, row by row (docs/your-video.md)."""
    found = words.found
    extra: dict[str, Any] = {
        "format": "tg4mm",
        "kind": "look",
        "source": str(words.source),
        "pictures": len(found.times_s),
        "fps": found.rate,
        "duration_s": found.duration_s,
        "repeats": list(found.repeats),
        "smallest": [asdict(s) for s in found.smallest],
        "cannot_tell": words.cannot(),
        "regions": [
            {"name": r.region.name, "noise_px": r.noise_px, "remark": r.remark}
            | {"lines": [asdict(line) | {"cells": None, "region": None} for line in r.lines]}
            for r in found.regions
        ],
    }
    write_json(path, extra | to_record(found))


def write_page(words: LookText, path: Path) -> None:
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


def _stats(words: LookText) -> list[Stat]:
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


def write_picture(words: LookText, path: Path) -> None:
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
