"""`tg4mm analyse`: levels, averaged spectra, zones, transfer functions, modes, comparison."""

from pathlib import Path
from typing import Annotated

import typer

from tg4mm.cli.magnify import parse_bands
from tg4mm.core.errors import Tg4mmError


def analyse(
    measured: Annotated[
        Path,
        typer.Argument(
            metavar="MEASURED",
            help="A folder of tg4mm measure, a CSV file with a column of times (time_s), or a universal file.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for analysis.json, CSV files and plots.")],
    channel: Annotated[
        list[str] | None,
        typer.Option(metavar="SENSOR/AXIS", help="A channel; may be repeated. [default: all]"),
    ] = None,
    band: Annotated[
        list[str] | None,
        typer.Option(
            metavar="LO HI", help="Hz, of levels and modes. [default: from two cycles in the record on]"
        ),
    ] = None,
    window: Annotated[str, typer.Option(help="Of averaged spectra, as scipy calls it.")] = "hann",
    segment: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Length of a segment. [default: eight averages]")
    ] = None,
    overlap: Annotated[float, typer.Option(help="Share of a segment that the next one has, too.")] = 0.5,
    machine_class: Annotated[
        str | None,
        typer.Option(metavar="I|II|III|IV", help="Zone of ISO 20816-1 for a machine of this class."),
    ] = None,
    with_: Annotated[
        Path | None,
        typer.Option(
            "--with", metavar="FILE", help="CSV of an accelerometer or a hammer: transfer functions to it."
        ),
    ] = None,
    input_: Annotated[
        str | None, typer.Option("--input", metavar="COLUMN", help="Of --with. [default: the one]")
    ] = None,
    sync: Annotated[
        str | None,
        typer.Option(
            metavar="COLUMN",
            help="Of --with: an accelerometer where the first channel is, that tells the lag. [default: the input]",
        ),
    ] = None,
    lag: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="The film's clock less the instrument's. [default: estimated]"),
    ] = None,
    speed: Annotated[
        str | None,
        typer.Option(
            metavar="RPM|auto",
            help="Revolutions per minute: amplitudes of orders of it. auto: the strongest line of the first channel.",
        ),
    ] = None,
    tacho: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="In place of --speed, a CSV file by the film's clock: pulse_s, a time for each turn, or time_s and "
            "speed_rpm.",
        ),
    ] = None,
    order: Annotated[
        list[float] | None, typer.Option(help="An order of the speed; may be repeated. [default: 1 to 6]")
    ] = None,
    against: Annotated[
        Path | None,
        typer.Option(metavar="MEASURED", help="An earlier record of the same sensors: what changed."),
    ] = None,
    modes: Annotated[
        bool, typer.Option("--modes", help="Modal parameters, by SSI-cov and FDD; with --with by LSCF, too.")
    ] = False,
) -> None:
    """Compute what an engineer wants: mm/s rms, averaged spectra, transfer functions, modes, changes, each ±."""
    from tg4mm.show.analyse.spectra import Averaging
    from tg4mm.show.analyse.table import format_analysis
    from tg4mm.show.analyse.write import AnalyseOptions, work_folder, write_analysis
    from tg4mm.show.analyse.write import analyse as analysed

    bands = parse_bands(band)
    if len(bands) > 1 or bands[:1] == [None]:
        raise Tg4mmError("--band is given once, as two frequencies")
    if with_ is None and (input_, sync, lag) != (None, None, None):
        raise Tg4mmError("--input, --sync and --lag belong to --with FILE")
    if speed is not None and tacho is not None:
        raise Tg4mmError("--speed and --tacho exclude each other")
    if order and speed is None and tacho is None:
        raise Tg4mmError("--order belongs to --speed or --tacho")
    averaging = Averaging(window, segment, overlap)
    options = AnalyseOptions(
        channel or (),
        bands[0] if bands else None,
        averaging,
        machine_class,
        with_,
        input_,
        sync,
        lag,
        against,
        modes,
        speed,
        tacho,
        order or (),
    )
    folder = work_folder(out)
    folder.check()
    found = analysed(measured, options)
    with folder.held("writes an analysis there"):
        write_analysis(found, out, averaging)
    typer.echo(f"{format_analysis(found)}{out}")
