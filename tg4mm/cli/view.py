"""`tg4mm view`: a run in the browser."""

from __future__ import annotations

import math
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tg4mm.cli.magnify import BandOption, parse_bands
from tg4mm.core.errors import Tg4mmError

if TYPE_CHECKING:
    from tg4mm.show.view.session import Session


def view(
    run: Annotated[
        Path,
        typer.Argument(
            metavar="INPUT",
            help="A run folder made by tg4mm train, or the folder of tg4mm process. Or a video, a folder of its "
            "numbered pictures, or a dataset, to draw regions and a scale on.",
        ),
    ],
    alpha: Annotated[
        float | None,
        typer.Option(
            help="Magnification at the start: a displacement δ becomes (1 + alpha) δ. [default: one at which the "
            "strongest motion can be seen]"
        ),
    ] = None,
    band: BandOption = None,
    regions: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="File of the regions, read if it exists. [default: NAME-regions.json in the current folder]",
        ),
    ] = None,
    fps: Annotated[
        float | None, typer.Option(help="Frame rate in Hz of a folder of pictures, or of slow motion.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for snapshots and clips. [default: RUN/view]")
    ] = None,
    port: Annotated[int, typer.Option(help="Port on 127.0.0.1; 0 takes a free one.")] = 8474,
    open: Annotated[bool, typer.Option(help="Open the page in the browser.")] = True,
) -> None:
    """Show a run in the browser, with sliders for α and band; or draw regions on a recording.

    The page can be opened on this machine only (127.0.0.1), at the address that is printed. Ctrl+C stops the server.
    """
    bands = parse_bands(band)
    if alpha is not None and not math.isfinite(alpha):
        raise Tg4mmError(f"--alpha {alpha}: expected a finite number")
    if len(bands) > 1:
        raise Tg4mmError(f"--band is given {len(bands)} times: the view magnifies one band at a time")
    from tg4mm.show.view.app import App
    from tg4mm.show.view.local_server import browsed

    if (run / "process.json").is_file() and (run / "run").is_dir():
        run = run / "run"
    if not (run / "config.json").is_file():
        _draw(run, regions, fps, port, open)
        return
    session = _session(run, alpha, bands[0] if bands else None)
    app = App(session, port, out or run / "view")
    typer.echo(f"{app.url}  (Ctrl+C ends)")
    for note in session.scene.notes:
        typer.echo(note, err=True)
    try:
        with browsed(app.url, run) if open else nullcontext():
            app.wait()
    except KeyboardInterrupt:
        typer.echo("", err=True)  # the terminal shows ^C
    finally:
        app.stop()


def _draw(source: Path, file: Path | None, fps: float | None, port: int, open_page: bool) -> None:
    """The desk on a recording without a run."""
    from tg4mm.core.regions import read_regions
    from tg4mm.show.view.desk import Desk
    from tg4mm.show.view.local_server import browsed

    if not source.exists():
        raise Tg4mmError(f"{source}: does not exist")
    file = file or Path(f"{source.resolve().stem}-regions.json")
    desk = Desk(source, file, read_regions(file) if file.is_file() else None, port, fps)
    typer.echo(f"{desk.url}  (Ctrl+C ends)")
    try:
        with browsed(desk.url, Path.cwd()) if open_page else nullcontext():
            desk.wait()
    except KeyboardInterrupt:
        typer.echo("", err=True)
    finally:
        desk.stop()


def _session(run: Path, alpha: float | None, band: tuple[float, float] | None) -> Session:
    from tg4mm.core.magnification import Magnification, check_band
    from tg4mm.run import Run
    from tg4mm.show.view.painter import Look
    from tg4mm.show.view.scene import open_scene
    from tg4mm.show.view.session import Clock, Session, slow_enough

    scene = open_scene(Run.open(run))
    if band is not None and scene.motion is not None:
        band = check_band(band, scene.motion.fps)
    plan = Magnification.of(
        scene.alpha_to_see() if alpha is None else alpha, *(() if band is None else (band,))
    )
    strongest = scene.strongest(plan)
    speed = 1.0
    if strongest is not None and scene.motion is not None:
        speed = slow_enough(float(scene.motion.freqs_hz[strongest]))
    look = Look(plan, beside=scene.duration > 0)
    return Session(scene, look, Clock(scene.duration, speed=speed, playing=scene.duration > 0))
