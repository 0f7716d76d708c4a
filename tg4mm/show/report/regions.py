"""The section on a flat capture's regions: the composite spectrum, and where what vibrates or moves by itself."""

from functools import partial

from tg4mm.capture.look import LookLine
from tg4mm.core.pages.charts import chart
from tg4mm.core.pages.page import Block, Figure, Section, Table, Text, drawing, picture
from tg4mm.run.stages.look import look_of
from tg4mm.show.regions import composite, region_picture
from tg4mm.show.report.sources import contact_images
from tg4mm.show.report.summary import Material
from tg4mm.show.result.model import Length, with_deviation

_HEADER = ["frequency (Hz)", "amplitude (px)", "damping ratio", "around pixel (x, y)", "change", "remark"]


def regions_section(m: Material) -> list[Section]:
    """Of a flat capture that was looked at; else []."""
    found = None if m.train.kind.sees_depth else look_of(m.run)
    if found is None:
        return []
    words = (
        f"The picture was cut into cells of {found.cell_px} pixels, each cell's shift was measured in every picture, "
        "and lines were sought region by region, the strongest first, each tested by itself. What no small shift "
        "explains moves by itself and is left out of the fit."
    )
    spectrum = Figure(
        [drawing(chart(partial(composite, found=found), "composite spectrum over all cells", (6.6, 3.0)))],
        "Composite spectrum: power over noise, mean over all cells; 1 where nothing vibrates. Dashed: what noise alone "
        "exceeds anywhere in one recording of a hundred. Dotted: lines of the light.",
        width="narrow",
    )
    seen = region_picture(found, contact_images(m.train, 1)[0])
    where = Figure(
        [picture(seen, alt="what vibrates and what moves by itself", photo=True)],
        "Coloured: cells that show a line, and its direction; the first colour is the strongest. Striped: what moves "
        "by itself. White frames: that, and where something passes.",
    )
    blocks: list[Block] = [Text(words), spectrum, where]
    if found.lines:
        caption = "Lines of the regions, the largest amplitude first; a remark says why a line may be none of its own."
        blocks.append(Table(_HEADER, [_row(line) for line in found.lines], caption, left=len(_HEADER)))
    return [Section("Region by region", blocks)]


def _row(line: LookLine) -> list[str]:
    damping = "–"
    if line.damping is not None:
        percent = None if line.damping_deviation is None else 100 * line.damping_deviation
        damping = f"{with_deviation(Length(100 * line.damping, percent))} %"
    return [
        with_deviation(Length(line.hz, line.hz_deviation)),
        with_deviation(Length(line.amplitude_px, line.amplitude_deviation_px, bool(line.lost))),
        damping,
        f"({line.centre_px[0]:.0f}, {line.centre_px[1]:.0f})",
        line.change,
        line.mark,
    ]
