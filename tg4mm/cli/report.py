"""`tg4mm report`: a run on one page."""

from pathlib import Path
from typing import Annotated

import typer

from tg4mm.cli.magnify import BandOption, EmptyBandOption, known_bands, parse_bands
from tg4mm.core.errors import Tg4mmError


def report(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run folder made by tg4mm train.")],
    out: Annotated[Path | None, typer.Option(help="The HTML file. [default: RUN/report.html]")] = None,
    alpha: Annotated[
        float | None,
        typer.Option(
            help="Magnification: a displacement δ becomes (1 + alpha) δ. [default: the largest motion "
            "becomes about 4 % of the picture, its noise stays below a pixel]"
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
    pdf: Annotated[
        bool,
        typer.Option(
            "--pdf", help="Also write a PDF beside the page; needs Chromium, Chrome, Edge, or the extra pdf."
        ),
    ] = False,
) -> None:
    """Write a report of a run: one HTML file.

    It shows videos, space-time slices, maps, spectra, measurements, warnings, settings, commands to repeat them, and
    errors if the dataset has ground truth. Lengths are in mm if the scale is known, else in scene units. The page needs
    no network.
    """
    asked = parse_bands(band)
    if len(asked) > 1:
        raise Tg4mmError(
            f"--band is given {len(asked)} times: a report magnifies one band, or every frequency"
        )
    from tg4mm.core.magnification import Magnification
    from tg4mm.research.evaluate.run import evaluate_run
    from tg4mm.run import Run
    from tg4mm.show.measure import parse_sensor
    from tg4mm.show.measure.locate import check_sensors
    from tg4mm.show.measure.sensors import checked_names
    from tg4mm.show.report import ReportOptions, write_report
    from tg4mm.show.report.pdf import print_pdf, printer
    from tg4mm.show.result.requested import refuse_empty

    browser = printer() if pdf else None
    sensors = checked_names([parse_sensor(text) for text in sensor or []])
    opened = Run.open(run)
    if sensors:
        check_sensors(opened, sensors)
    bands = known_bands(opened, asked)
    if not allow_empty_band:
        refuse_empty(opened, Magnification.of(1.0, *bands))
    options = ReportOptions(
        alpha=alpha, band=bands[0] if bands else None, sensors=sensors, evaluate=evaluate_run
    )
    path = write_report(opened, out or run / "report.html", options)
    written = [path, *([] if browser is None else [print_pdf(path, browser)])]
    for file in written:
        typer.echo(f"{file}: {file.stat().st_size / 1e6:.1f} MB")
