"""What a run found, from its `Result`: a table of vibrations, and what cannot be told."""

from __future__ import annotations

from markupsafe import Markup

from tg4mm.core.pages.page import Block, Section, Table, Text
from tg4mm.show.report.summary import Material, size_of
from tg4mm.show.result.lines import with_deviation
from tg4mm.show.result.model import Length, Vibration


def vibrations_table(m: Material) -> list[Block]:
    """Every vibration that was found; nothing where there is none."""
    if not m.result.vibrations:
        return []
    header = [
        "frequency (Hz)",
        "amplitude",
        "in pictures",
        "damping ratio",
        "largest at pixel" if m.result.is_flat else "largest at (x, y, z)",
        "band (Hz)",
    ]
    caption = (
        "Vibrations that the run found, the strongest first: peak displacement where it is largest (1 % of what is "
        "seen moves further), ± one standard deviation. The band is what --band takes to magnify one alone."
    )
    rows = [_row(m, v) for v in m.result.vibrations]
    return [Table(header, rows, caption)]


def _row(m: Material, v: Vibration) -> list[str]:
    value, unit = size_of(v, m.result)
    pixels = "–" if v.pixels is None else f"{with_deviation(v.pixels)} px"
    damping = "–"
    if v.damping is not None:
        percent = None if v.damping_deviation is None else 100 * v.damping_deviation
        damping = f"{with_deviation(Length(100 * v.damping, percent))} %"
    place = ", ".join(f"{c:.3g}" for c in v.place)
    if v.place_px is not None:
        place = f"pixel {v.place_px[0]:.0f}, {v.place_px[1]:.0f}"
    hz = with_deviation(Length(v.hz, v.deviation_hz))
    return [hz, f"{value} {unit}", pixels, damping, place, f"{v.band[0]:g} to {v.band[1]:g}"]


def limits_section(m: Material) -> Section:
    """What could not be told, of the run and of the sensors."""
    measured = () if m.measurement is None else m.measurement.notes
    lines = list(
        dict.fromkeys([*m.result.cannot, *measured, *([m.why_no_sensors] if m.why_no_sensors else [])])
    )
    damping = sorted({v.why_no_damping for v in m.result.vibrations if v.why_no_damping})
    lines += [f"damping: {why}" for why in damping if not any(why in line for line in lines)]
    if not lines:
        return Section("What could not be told", [Text("Nothing that this run knows of.")])
    items = Markup("").join(Markup("<li>{}</li>").format(line[:1].upper() + line[1:]) for line in lines)
    return Section(
        "What could not be told", [Text(Markup('<ul class="points">{}</ul>').format(items), plain=True)]
    )
