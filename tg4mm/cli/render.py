"""`tg4mm render`: pictures and videos of a run, its motion magnified."""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tg4mm.cli.device import Device, DeviceOption
from tg4mm.cli.magnify import (
    BandOption,
    EmptyBandOption,
    FilterOption,
    MethodOption,
    check_magnified,
    check_paired,
    known_bands,
    magnified,
    parse_bands,
    temporal_filter,
    warn_too_far,
)
from tg4mm.core.errors import CaptureError, Tg4mmError

if TYPE_CHECKING:
    from tg4mm.run import Run
    from tg4mm.show.render.cameras import Camera


class PathOf(StrEnum):
    """Whose way the camera goes."""

    capture = "capture"


class Split(StrEnum):
    """Which cameras of the dataset."""

    test = "test"
    train = "train"


def render(
    run: Annotated[
        Path,
        typer.Argument(
            metavar="RUN", help="A run folder made by tg4mm train, or a splat file with --cameras."
        ),
    ],
    alpha: Annotated[
        list[float],
        typer.Option(
            help="Magnification: a displacement δ becomes (1 + alpha) δ; 0 as captured, -1 at rest, below -1 "
            "inverted. With several --band give one for each."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the pictures; finished pictures are not repeated.")],
    band: BandOption = None,
    method: MethodOption = None,
    filter: FilterOption = None,
    suppressed: Annotated[
        bool,
        typer.Option("--suppressed", help="With phase: remove all motion outside the bands, as in 3DMM."),
    ] = False,
    amplitude_percentile: Annotated[
        float,
        typer.Option(
            help="With phase: keep the phase where a sub-band's amplitude is below this percentile, as in "
            "3DMM."
        ),
    ] = 0.0,
    split: Annotated[Split | None, typer.Option(help="Cameras of the dataset. [default: test]")] = None,
    cameras: Annotated[
        Path | None, typer.Option(help="Cameras of a transforms.json file (NeRF or nerfstudio).")
    ] = None,
    orbit: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Number of pictures on one orbit around the scene; back and forth if it was filmed from one side.",
        ),
    ] = None,
    path: Annotated[
        PathOf | None,
        typer.Option(help="capture: one video along the capture's path, picture t from pose t."),
    ] = None,
    slow: Annotated[float, typer.Option(help="Slow motion: 2 plays at half speed.")] = 1.0,
    video: Annotated[bool, typer.Option(help="Also write an mp4 for each camera.")] = True,
    frequencies: Annotated[
        str | None,
        typer.Option(
            metavar="HZ,HZ,…",
            help="For a splat file with motion whose header line was lost in another program: the frequency of each "
            "mode. Without them it is drawn without motion.",
        ),
    ] = None,
    fps: Annotated[float, typer.Option(help="With --frequencies: timesteps per second, Hz.")] = 30.0,
    allow_empty_band: EmptyBandOption = False,
    device: DeviceOption = Device.cpu,
) -> None:
    """Render pictures and videos of a run, or of a splat file, with magnified motion.

    Writes OUT/<timestep>/<camera>.png and OUT/<camera>.mp4; with --orbit, OUT/r_000.png … and OUT/orbit.mp4; with
    --path, OUT/r_000.png … and OUT/path.mp4. Give one of --split, --cameras, --orbit and --path.
    """
    asked_for = {"--split": split, "--cameras": cameras, "--orbit": orbit, "--path": path}
    given = [name for name, value in asked_for.items() if value is not None]
    if len(given) > 1:
        raise Tg4mmError(f"{given[0]} and {given[1]} exclude each other")
    if path is not None and slow != 1:
        raise Tg4mmError(f"--slow {slow:g} and --path exclude each other: picture t shows timestep t")
    if orbit is not None and not video:
        raise Tg4mmError("--no-video and --orbit exclude each other: an orbit is a video")
    if slow != 1 and not video:
        raise Tg4mmError(f"--slow {slow:g} and --no-video exclude each other: only videos have a speed")
    asked = parse_bands(band)
    check_paired(alpha, asked)
    chosen_filter = temporal_filter(filter, asked)
    from tg4mm.core.splatfile.drawable import parsed_frequencies
    from tg4mm.fit.device import check_device
    from tg4mm.run.splat_run import LOW_PASS_PX2, SplatRun, cameras_asked, open_run
    from tg4mm.show.render.sequence import RenderRequest, render_orbit, render_path, render_sequence

    check_device(device.value)
    opened = open_run(run, parsed_frequencies(frequencies or ""), fps)
    if cameras is None:
        cameras_asked(opened, given[0] if given else None)
    low_pass = opened.low_pass_px2 if isinstance(opened, SplatRun) else LOW_PASS_PX2
    plan = magnified(alpha, known_bands(opened, asked), method, chosen_filter)
    plan = replace(plan, suppressed=suppressed, amplitude_percentile=amplitude_percentile)
    request = RenderRequest(plan, slow=slow, low_pass_px2=low_pass).checked()
    check_magnified(opened, plan, allow_empty_band)
    warn_too_far(opened, plan)
    if path is not None:
        cameras_on_path = path_cameras(opened)
        render_path(opened, cameras_on_path, request, out, video=video, device=device.value)
    elif orbit is not None:
        render_orbit(opened, orbit_cameras(opened, orbit), request, out, device=device.value)
    else:
        chosen = split_cameras(opened, split) if cameras is None else file_cameras(opened, cameras)
        render_sequence(opened, chosen, request, out, video=video, device=device.value)
    typer.echo(str(out))


def split_cameras(run: Run, split: Split | None) -> tuple[Camera, ...]:
    """The cameras of one split of the run's dataset; None is the test split, with an error that names the others."""
    from tg4mm.capture import load_capture
    from tg4mm.show.render.cameras import capture_cameras

    try:
        return capture_cameras(load_capture(run.dataset, split=(split or Split.test).value))
    except CaptureError as error:
        if split is not None:
            raise
        load_capture(run.dataset)  # raises where more than the test split is wrong
        raise CaptureError(f"{error}; choose --split train, --orbit N or --cameras FILE") from None


def path_cameras(run: Run) -> tuple[Camera, ...]:
    """One for each timestep of the run's dataset. Raises CaptureError where the timesteps have several poses each."""
    from tg4mm.capture import load_capture
    from tg4mm.show.render.cameras import capture_path

    return capture_path(load_capture(run.dataset))


def file_cameras(run: Run, path: Path) -> tuple[Camera, ...]:
    """The cameras of a file; where it does not say, pictures are as large as the dataset's, or as its own first one."""
    from tg4mm.capture import load_capture
    from tg4mm.capture.cameras import relative_to
    from tg4mm.run.splat_run import SplatRun
    from tg4mm.show.render.cameras import cameras_from_file, size_of_first_picture

    if isinstance(run, SplatRun):
        return cameras_from_file(path, size_of_first_picture(path))
    capture = load_capture(run.dataset)
    cameras = cameras_from_file(path, (capture.width, capture.height))
    return tuple(replace(c, viewmat=relative_to(c.viewmat[None], capture.origin)[0]) for c in cameras)


def orbit_cameras(run: Run, n: int) -> tuple[Camera, ...]:
    """`n` cameras on a circle around what the dataset's cameras look at, or else the Gaussians' middle."""
    from tg4mm.capture import load_capture
    from tg4mm.show.render.cameras import orbit

    centre = run.load_space().means.median(dim=0).values.numpy()
    return orbit(load_capture(run.dataset), n, centre)
