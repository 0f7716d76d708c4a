"""`tg4mm measure`: virtual sensors."""

from pathlib import Path
from typing import Annotated

import typer

from tg4mm.cli.magnify import parse_bands
from tg4mm.cli.regions import RegionsOption, read_drawn
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.values import NOT_NEGATIVE, POSITIVE, Maybe, require


def measure(
    run: Annotated[
        Path,
        typer.Argument(
            metavar="RUN",
            help="A run folder made by tg4mm train, or the video of a fixed camera, which needs no training and is "
            "measured in pixels.",
        ),
    ],
    out: Annotated[
        Path, typer.Option(help="Folder for measure.json, files of --formats, plots and animated pictures.")
    ],
    sensor: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=REGION",
            help="A sensor; may be given several times. REGION: all, box:X0,Y0,Z0,X1,Y1,Z1, sphere:X,Y,Z,RADIUS (scene "
            "units), pixel:CAMERA,X,Y[,RADIUS] (pixels of a training view), cluster:NUMBER, cluster:still. [default: "
            "clusters that move alike, and all]",
        ),
    ] = None,
    sensors: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Sensors in a YAML file (docs/measure.md).")
    ] = None,
    regions: RegionsOption = None,
    reference: Annotated[
        str | None, typer.Option(help="Reference sensor of phases and coherence. [default: the first]")
    ] = None,
    band: Annotated[
        list[str] | None,
        typer.Option(
            "--band",
            metavar="LO HI",
            help="A band in which every sensor gets a peak, found or not, Hz. [default: the one given to train]",
        ),
    ] = None,
    formats: Annotated[
        str,
        typer.Option(
            metavar="LIST",
            help="Output formats, separated by commas: csv, uff (universal file), mat (MATLAB), hdf5, xlsx.",
        ),
    ] = "csv,uff,mat,hdf5,xlsx",
    keep: Annotated[
        bool,
        typer.Option(
            "--keep/--no-keep",
            help="Cache what is read from the pictures in the run folder, so that the next call is fast; for a flat "
            "capture nothing is cached.",
        ),
    ] = True,
    animate: Annotated[
        bool,
        typer.Option("--animate/--no-animate", help="Write animated pictures of the shape at every peak."),
    ] = True,
    fps: Annotated[
        float | None,
        typer.Option(
            help="Of a video: pictures a second at which it was filmed. [default: the file's own times]"
        ),
    ] = None,
    readout: Annotated[
        float | None,
        typer.Option(
            metavar="MS",
            help="Of a video: milliseconds from a picture's first row to its last (rolling shutter). [default: all "
            "rows are taken to be read at once]",
        ),
    ] = None,
) -> None:
    """Measure displacement over time with virtual sensors.

    The displacement of a sensor is measured in the pictures, frame by frame, with a standard deviation for each sample
    (mm if the scale is known, else scene units). Its spectrum (Hz) has a noise floor and the peaks above it.
    """
    from tg4mm.capture import load_capture
    from tg4mm.core.temporary import remove_leftovers
    from tg4mm.fit.motion.observations import frames_of
    from tg4mm.run import Run
    from tg4mm.show.measure import measure as measured
    from tg4mm.show.measure import parse_sensor, prepare, prepare_video, read_sensors
    from tg4mm.show.measure.locate import check_sensors
    from tg4mm.show.measure.sensors import checked_names, drawn_sensors
    from tg4mm.show.measure.video import is_video
    from tg4mm.show.measure.write import parse_formats, work_folder, write_measurement

    asked = [*(read_sensors(sensors) if sensors else []), *(parse_sensor(text) for text in sensor or [])]
    drawn = read_drawn(regions)
    wanted = parse_formats(formats)
    require("--fps", fps, Maybe(POSITIVE), Tg4mmError)
    require("--readout", readout, Maybe(NOT_NEGATIVE), Tg4mmError)
    opened = None if is_video(run) else Run.open(run)
    if opened is not None and (fps is not None or readout is not None):
        raise Tg4mmError("--fps and --readout are of a video; a run has them from tg4mm sfm")
    if drawn is not None and opened is not None:
        capture = load_capture(opened.dataset, split="train")
        drawn.check_size((capture.width, capture.height), opened.dataset)
        asked += drawn_sensors(drawn, [frame.name for frame in frames_of(capture)[1]])
    scene = None if opened is not None else prepare_video(run, fps, (readout or 0.0) / 1e3)
    if drawn is not None and scene is not None:
        drawn.check_size(scene.observations.size, run)
        asked += drawn_sensors(drawn, [run.stem])
    checked_names(asked)
    if reference is not None and asked and reference not in [s.name for s in asked]:
        raise Tg4mmError(
            f"--reference {reference!r} is not a sensor; sensors: {', '.join(s.name for s in asked)}"
        )
    bands = parse_bands(band)
    if len(bands) > 1 or None in bands:
        raise Tg4mmError("--band: a measurement takes one band, two frequencies in Hz, LO HI")
    chosen = bands[0] if bands else None
    if opened is not None:
        check_sensors(opened, asked)
    with work_folder(out).held("writes a measurement there"):
        remove_leftovers(out)
        scale = None if drawn is None else drawn.scale
        if opened is not None:
            scene = prepare(opened, keep)
        assert scene is not None
        found = measured(scene, asked or None, reference, band=chosen, scale=scale)
        typer.echo(write_measurement(found, out, animate, wanted), nl=False)
