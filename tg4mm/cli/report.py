"""`tg4mm report`: a run on one page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tg4mm.cli.magnify import BandOption, EmptyBandOption, known_bands, parse_bands
from tg4mm.errors import Tg4mmError


def report(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run folder made by tg4mm train.")],
    out: Annotated[Path | None, typer.Option(help="The HTML file. [default: RUN/report.html]")] = None,
    alpha: Annotated[
        float | None,
        typer.Option(
            help="Magnification: a displacement δ becomes (1 + alpha) δ. [default: what shows the largest motion well "
            "and not its noise; the page says the rule]"
        ),
    ] = None,
    band: BandOption = None,
    sensor: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=REGION",
            help="A sensor, as for tg4mm measure; may be repeated. [default: clusters that move alike, and all]",
        ),
    ] = None,
    allow_empty_band: EmptyBandOption = False,
) -> None:
    """Write everything about a run on one page: a file that any browser shows, without a network.

    Videos, slices, maps, spectra, what sensors measure, what could not be told, settings and commands to repeat it;
    where the dataset has ground truth, also how true the result is. Lengths are in mm where the scale is known, else in
    scene units.
    """
    asked = parse_bands(band)
    if len(asked) > 1:
        raise Tg4mmError(
            f"--band is given {len(asked)} times: a report magnifies one band, or every frequency"
        )
    from tg4mm.magnify import BandGain, Magnification
    from tg4mm.measure import parse_sensor
    from tg4mm.measure.sensors import checked_names
    from tg4mm.report import ReportOptions, write_report
    from tg4mm.result.requested import refuse_empty
    from tg4mm.runs import Run

    sensors = checked_names([parse_sensor(text) for text in sensor or []])
    opened = Run.open(run)
    bands = known_bands(opened, asked)
    if not allow_empty_band:
        refuse_empty(opened, Magnification(tuple(BandGain(*one, 1.0) for one in bands)))
    options = ReportOptions(alpha=alpha, band=bands[0] if bands else None, sensors=sensors)
    path = write_report(opened, out or run / "report.html", options)
    typer.echo(f"{path}: {path.stat().st_size / 1e6:.1f} MB")
