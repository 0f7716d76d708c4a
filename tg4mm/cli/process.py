"""`tg4mm process`: from a video to numbers, pages and a magnified video, in one folder."""

from pathlib import Path
from typing import Annotated

import typer

from tg4mm.cli.device import Device, DeviceOption
from tg4mm.cli.magnify import BandOption, parse_bands
from tg4mm.cli.regions import RegionsOption, read_drawn
from tg4mm.cli.sfm import (
    BaselineOption,
    FpsOption,
    FromOption,
    InputArgument,
    KeepDuplicatesOption,
    KindOption,
    LengthFileOption,
    LengthOption,
    ReadoutOption,
    ScaleOption,
    SynchronousOption,
    ThreadsOption,
    UntilOption,
    length_of,
)
from tg4mm.cli.train import SettingsOption, split_settings
from tg4mm.core.errors import Tg4mmError


def process(
    source: InputArgument,
    out: Annotated[Path, typer.Option(help="Folder for everything; an unfinished one is resumed.")],
    kind: KindOption = None,
    fps: FpsOption = None,
    readout: ReadoutOption = None,
    start: FromOption = 0.0,
    until: UntilOption = None,
    keep_duplicates: KeepDuplicatesOption = False,
    unit_scale_m: ScaleOption = None,
    baseline: BaselineOption = None,
    length: LengthOption = None,
    length_file: LengthFileOption = None,
    synchronous: SynchronousOption = False,
    sensor: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=REGION",
            help="A sensor, as for tg4mm measure; may be repeated. [default: clusters that move alike, and all]",
        ),
    ] = None,
    regions: RegionsOption = None,
    only: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Only this region of --regions: it alone is measured, its strongest line magnified in a video of its "
            "surroundings; no pages.",
        ),
    ] = None,
    alpha: Annotated[
        float | None,
        typer.Option(
            help="Magnification of the video: a displacement δ becomes (1 + alpha) δ. [default: one at which the "
            "motion can be seen]"
        ),
    ] = None,
    band: BandOption = None,
    quick: Annotated[
        bool,
        typer.Option(
            "--quick",
            help="A coarse first answer: in 3D 1,000 iterations and 10,000 Gaussians; numbers and the video, no pages.",
        ),
    ] = False,
    all_files: Annotated[
        bool,
        typer.Option(
            "--all-files",
            help="Keep the magnified video's pictures (magnified/), write plots as SVG, too, and the whole scene to "
            "page.html, which else is at most 10 MB.",
        ),
    ] = False,
    settings: SettingsOption = None,
    device: DeviceOption = Device.cpu,
    threads: ThreadsOption = 0,
) -> None:
    """Do everything with a video: poses, training, numbers, a magnified video and pages.

    Writes OUT/dataset (tg4mm sfm), OUT/run (train), OUT/measured (measure), OUT/magnified.mp4 of the strongest
    vibration (render), OUT/report.html (report) and OUT/page.html (export --format html). Steps that are finished are
    not repeated; with another option, what it changes is done again, and the folder of before is kept as run_1.
    """
    bands = parse_bands(band)
    if len(bands) > 1:
        raise Tg4mmError(f"--band is given {len(bands)} times: one video magnifies one band")
    chosen = split_settings(settings or [])
    from tg4mm.capture.sfm.config import SfmConfig
    from tg4mm.run.train import parse_settings
    from tg4mm.show.measure import parse_sensor
    from tg4mm.show.measure.sensors import checked_names
    from tg4mm.show.process import ProcessOptions
    from tg4mm.show.process import process as processed

    parse_settings(chosen)
    config = SfmConfig(
        kind=None if kind is None else kind.value,
        fps=fps,
        readout_s=None if readout is None else readout / 1e3,
        start_s=start,
        stop_s=until,
        unit_scale_m=unit_scale_m,
        baseline=baseline,
        length=length_of(length, length_file),
        keep_duplicates=keep_duplicates,
        synchronous=synchronous,
    )
    options = ProcessOptions(
        config,
        chosen,
        device.value,
        checked_names([parse_sensor(text) for text in sensor or []]),
        alpha,
        bands[0] if bands else None,
        read_drawn(regions),
        only or "",
        quick,
        all_files,
        threads or -1,
    )
    processed(source, out, options, typer.echo)
