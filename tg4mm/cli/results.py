"""The commands that take a run or a measurement: render, measure, analyse, evaluate, report, view, export."""

from __future__ import annotations

import logging
import math
import sys
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.options import Band, MagnifyOptions
from tg4mm.core.values import NOT_NEGATIVE, POSITIVE, Maybe, require
from tg4mm.show.options import Format, LowPass, Split

if TYPE_CHECKING:
    from tg4mm.core.magnification import Magnification
    from tg4mm.research.options import EvaluateOptions
    from tg4mm.run import Run
    from tg4mm.show.measure import Prepared, Sensor
    from tg4mm.show.options import (
        AnalyseCommand,
        ExportOptions,
        MeasureOptions,
        RenderOptions,
        ReportCommand,
        ViewOptions,
    )
    from tg4mm.show.render.cameras import Camera
    from tg4mm.show.view.session import Session

_LOG = logging.getLogger("tg4mm")
_MAGNIFIED = ("--alpha", "--band", "--method", "--filter", "--timesteps")
_TAKEN = {
    Format.ply_sequence: _MAGNIFIED,
    Format.spz: _MAGNIFIED,
    Format.usd: _MAGNIFIED,
    Format.gltf: ("--alpha", "--band"),
}
_HOLDS = {
    Format.ply: "a splat file contains the motion itself",
    Format.html: "a page contains the motion itself",
    Format.gltf: "a .glb contains complete modes",
}


def known_bands(run: Run, bands: Sequence[Band | None]) -> list[Band]:
    """Resolve the bands; the band chosen for `auto` is reported. Raises Tg4mmError if the run has no vibration."""
    if None not in bands:
        return [band for band in bands if band is not None]
    from tg4mm.show.result.requested import auto_band

    auto, line = auto_band(run)
    _LOG.info(line)
    return [auto if band is None else band for band in bands]


def check_paired(alphas: Sequence[float], bands: Sequence[object]) -> None:
    """Raise Tg4mmError unless there is one alpha for each band."""
    if len(alphas) != max(len(bands), 1):
        need = "give one --alpha for each --band" if bands else "without --band give exactly one --alpha"
        raise Tg4mmError(f"--alpha is given {_times(alphas)}, --band {_times(bands)}: {need}")


def _times(given: Sequence[object]) -> str:
    return f"{len(given)} time{'' if len(given) == 1 else 's'}"


def magnified(run: Run, alphas: Sequence[float], options: MagnifyOptions, **more: Any) -> Magnification:
    """Return the magnification of the options: one α for each band, or one for all frequencies."""
    from tg4mm.core.magnification import BandGain, Magnification

    bands = known_bands(run, options.bands)
    gains = tuple(BandGain(*b, a) for b, a in zip(bands, alphas, strict=False))
    method = None if options.method is None else options.method.value
    return Magnification(gains, 0.0 if gains else alphas[0], method, options.temporal_filter, **more)


def check_magnified(run: Run, plan: Magnification, allow_empty: bool) -> None:
    """Raise Tg4mmError for a band without motion, unless allowed."""
    from tg4mm.show.result.requested import refuse_empty

    if not allow_empty:
        refuse_empty(run, plan)


def warn_too_far(run: Run, plan: Magnification) -> None:
    """Warn of reversed motion, and of motion magnified beyond its limits."""
    from tg4mm.show.result.requested import how_sure, reversed_motion, too_far

    for line in (reversed_motion(plan), too_far(run, plan), *how_sure(run, plan)):
        if line is not None:
            _LOG.warning(line)


def render(options: RenderOptions) -> None:
    """Run `tg4mm render`."""
    given = _check_render(options)
    from tg4mm.core.splatfile.model import parsed_frequencies
    from tg4mm.fit.device import check_device
    from tg4mm.run.folder import LOW_PASS_PX2, SplatRun, open_run, refuse_cameras
    from tg4mm.show.render.sequence import RenderRequest, render_orbit, render_path, render_sequence

    o, device, video = options, options.device.value, options.video
    check_device(device)
    opened = open_run(o.run, parsed_frequencies(o.frequencies or ""), o.fps)
    if o.cameras is None:
        refuse_cameras(opened, given[0] if given else None)
    low_pass = opened.low_pass_px2 if isinstance(opened, SplatRun) else LOW_PASS_PX2
    phase = {"suppressed": o.suppressed, "amplitude_percentile": o.amplitude_percentile}
    plan = magnified(opened, o.alpha, options, **phase)
    request = RenderRequest(plan, slow=o.slow, low_pass_px2=low_pass).checked()
    check_magnified(opened, plan, o.allow_empty_band)
    warn_too_far(opened, plan)
    if o.path is not None:
        render_path(opened, path_cameras(opened), request, o.out, video=video, device=device)
    elif o.orbit is not None:
        render_orbit(opened, orbit_cameras(opened, o.orbit), request, o.out, device=device)
    else:
        cameras = split_cameras(opened, o.split) if o.cameras is None else file_cameras(opened, o.cameras)
        render_sequence(opened, cameras, request, o.out, video=video, device=device)
    print(o.out)


def _check_render(options: RenderOptions) -> list[str]:
    """Return the options that select cameras. Raises Tg4mmError for options that exclude each other."""
    o = options
    cameras = {"--split": o.split, "--cameras": o.cameras, "--orbit": o.orbit, "--path": o.path}
    given = [name for name, value in cameras.items() if value is not None]
    if len(given) > 1:
        raise Tg4mmError(f"{given[0]} and {given[1]} cannot be used together")
    if o.path is not None and o.slow != 1:
        raise Tg4mmError(f"--slow {o.slow:g} and --path cannot be used together: picture t shows timestep t")
    if o.orbit is not None and not o.video:
        raise Tg4mmError(
            "--no-video cannot be used with --orbit, which is itself a video: leave out --no-video"
        )
    if o.slow != 1 and not o.video:
        raise Tg4mmError(
            f"--slow {o.slow:g} and --no-video cannot be used together: only videos have a speed"
        )
    check_paired(o.alpha, o.bands)
    _ = o.temporal_filter  # raises
    return given


def split_cameras(run: Run, split: Split | None) -> tuple[Camera, ...]:
    """Return the cameras of a split of the run's dataset; None: the test split, with an error that names the others."""
    from tg4mm.capture import load_capture
    from tg4mm.core.errors import CaptureError
    from tg4mm.show.render.cameras import capture_cameras

    try:
        return capture_cameras(load_capture(run.dataset, split=(split or Split.test).value))
    except CaptureError as error:
        if split is not None:
            raise
        load_capture(run.dataset)  # raises if more than the test split is wrong
        raise CaptureError(f"{error}; choose --split train, --orbit N or --cameras FILE") from None


def path_cameras(run: Run) -> tuple[Camera, ...]:
    """Return a camera for each timestep of the run's dataset. Raises CaptureError for several poses at one."""
    from tg4mm.capture import load_capture
    from tg4mm.show.render.cameras import capture_path

    return capture_path(load_capture(run.dataset))


def file_cameras(run: Run, path: Path) -> tuple[Camera, ...]:
    """Return the cameras of a file; a missing size is that of the dataset's pictures, or of the file's first one."""
    from tg4mm.capture import load_capture
    from tg4mm.capture.cameras import relative_to
    from tg4mm.run.folder import SplatRun
    from tg4mm.show.render.cameras import cameras_from_file, size_of_first_picture

    if isinstance(run, SplatRun):
        return cameras_from_file(path, size_of_first_picture(path))
    capture = load_capture(run.dataset)
    cameras = cameras_from_file(path, (capture.width, capture.height))
    return tuple(replace(c, viewmat=relative_to(c.viewmat[None], capture.origin)[0]) for c in cameras)


def orbit_cameras(run: Run, n: int) -> tuple[Camera, ...]:
    """Return `n` cameras on a circle around the subject of the dataset's cameras, or the Gaussians' middle."""
    from tg4mm.capture import load_capture
    from tg4mm.show.render.cameras import orbit

    centre = run.load_space().means.median(dim=0).values.numpy()
    return orbit(load_capture(run.dataset), n, centre)


def measure(options: MeasureOptions) -> None:
    """Run `tg4mm measure`."""
    require("--fps", options.fps, Maybe(POSITIVE), Tg4mmError)
    require("--readout", options.readout, Maybe(NOT_NEGATIVE), Tg4mmError)
    from tg4mm.core.files import remove_leftovers
    from tg4mm.show.measure import measure as measured
    from tg4mm.show.measure import read_sensors
    from tg4mm.show.measure.video import is_video
    from tg4mm.show.measure.write import parse_formats, work_folder, write_measurement

    o = options
    sensors = [*(read_sensors(o.sensors) if o.sensors else []), *o.sensor]
    formats = parse_formats(o.formats)
    scene = (_video_scene if is_video(o.run) else _run_scene)(options, sensors)
    scale = None if o.regions is None else o.regions.scale
    with work_folder(o.out).locked("writes a measurement there"):
        remove_leftovers(o.out)
        found = measured(scene(), sensors or None, o.reference, band=o.band, scale=scale)
        print(write_measurement(found, o.out, o.animate, formats), end="")


def _video_scene(options: MeasureOptions, sensors: list[Sensor]) -> Callable[[], Prepared]:
    from tg4mm.show.measure import prepare_video

    scene = prepare_video(options.run, options.fps, (options.readout or 0.0) / 1e3)
    _add_drawn(options, sensors, scene.observations.size, options.run, [options.run.stem])
    return lambda: scene


def _run_scene(options: MeasureOptions, sensors: list[Sensor]) -> Callable[[], Prepared]:
    from tg4mm.capture import load_capture
    from tg4mm.fit.motion.observations import frames_of
    from tg4mm.run import Run
    from tg4mm.show.measure import prepare
    from tg4mm.show.measure.locate import check_sensors

    opened = Run.open(options.run)
    if (options.fps, options.readout) != (None, None):
        raise Tg4mmError("--fps and --readout apply to a video; for a run, tg4mm sfm sets them")
    size, cameras = (0, 0), list[str]()
    if options.regions is not None:
        capture = load_capture(opened.dataset, split="train")
        size, cameras = (capture.width, capture.height), [frame.name for frame in frames_of(capture)[1]]
    _add_drawn(options, sensors, size, opened.dataset, cameras)
    check_sensors(opened, sensors)
    return lambda: prepare(opened, options.keep)


def _add_drawn(
    options: MeasureOptions, sensors: list[Sensor], size: tuple[int, int], source: Path, cameras: list[str]
) -> None:
    """Append the drawn sensors, and check all names."""
    from tg4mm.show.measure.sensors import checked_names, drawn_sensors

    if options.regions is not None:
        options.regions.check_size(size, source)
        sensors += drawn_sensors(options.regions, cameras)
    names = [s.name for s in checked_names(sensors)]
    if options.reference is not None and names and options.reference not in names:
        raise Tg4mmError(f"--reference {options.reference!r} is not a sensor; sensors: {', '.join(names)}")


def analyse(options: AnalyseCommand) -> None:
    """Run `tg4mm analyse`."""
    o = options
    if o.reference is None and (o.column, o.sync, o.lag) != (None, None, None):
        raise Tg4mmError("--input, --sync and --lag belong to --with FILE")
    if o.speed is not None and o.tacho is not None:
        raise Tg4mmError("--speed and --tacho cannot be used together")
    if o.orders and o.speed is None and o.tacho is None:
        raise Tg4mmError("--order belongs to --speed or --tacho")
    from tg4mm.show.analyse.results import analyse as analysed
    from tg4mm.show.analyse.results import format_analysis, work_folder, write_analysis

    folder = work_folder(o.out)
    folder.check()
    found = analysed(o.measured, options)
    with folder.locked("writes an analysis there"):
        write_analysis(found, o.out)
    print(f"{format_analysis(found)}{o.out}")


def evaluate(options: EvaluateOptions) -> None:
    """Run `tg4mm evaluate`."""
    _ = options.temporal_filter  # raises
    from tg4mm.fit.device import check_device
    from tg4mm.research.evaluate.run import check_alphas, evaluate_run, format_table, target_file
    from tg4mm.run import Run

    o, device = options, options.device.value
    check_device(device)
    opened = Run.open(o.run)
    alphas = None if o.alphas is None else list(o.alphas)
    largest = max(check_alphas(alphas, opened.dataset), default=0)
    plan = magnified(opened, [largest] * max(len(o.bands), 1), options)
    check_magnified(opened, plan, o.allow_empty_band)
    target_file(opened, o.out)  # raises if it cannot be written
    warn_too_far(opened, plan)
    weights = list(o.lpips_weights) or None
    print(
        format_table(evaluate_run(opened, alphas, o.out, plan, lpips_weights=weights, device=device)), end=""
    )


def report(options: ReportCommand) -> None:
    """Run `tg4mm report`."""
    from tg4mm.core.magnification import Magnification
    from tg4mm.research.evaluate.run import evaluate_run
    from tg4mm.run import Run
    from tg4mm.show.measure.locate import check_sensors
    from tg4mm.show.report import write_report
    from tg4mm.show.report.write import print_pdf, printer

    browser = printer() if options.pdf else None
    opened = Run.open(options.run)
    if options.sensors:
        check_sensors(opened, options.sensors)
    bands = known_bands(opened, options.bands)
    check_magnified(opened, Magnification.of(1.0, *bands), options.allow_empty_band)
    chosen = replace(options, band=bands[0] if bands else None, evaluate=evaluate_run)
    path = write_report(opened, options.out or options.run / "report.html", chosen)
    for file in (path, *([] if browser is None else [print_pdf(path, browser)])):
        print(f"{file}: {file.stat().st_size / 1e6:.1f} MB")


def view(options: ViewOptions) -> None:
    """Run `tg4mm view`."""
    if options.alpha is not None and not math.isfinite(options.alpha):
        raise Tg4mmError(f"--alpha {options.alpha}: expected a finite number")
    from tg4mm.show.view.app import App

    run = options.run
    if (run / "process.json").is_file() and (run / "run").is_dir():
        run = run / "run"
    if not (run / "config.json").is_file():
        return _draw(run, options)
    session = _session(run, options)
    app = App(session, options.port, options.out or run / "view")
    return _serve(app, run if options.open else None, session.scene.notes)


def _serve(server: Any, browse_from: Path | None, notes: Sequence[str] = ()) -> None:
    """Serve until Ctrl+C; `browse_from`: folder of the file that opens the browser, None: none is opened."""
    from tg4mm.show.view.local_server import browsed

    print(f"{server.url}  (Ctrl+C ends)", flush=True)
    for note in notes:
        print(note, file=sys.stderr)
    try:
        with nullcontext() if browse_from is None else browsed(server.url, browse_from):
            server.wait()
    except KeyboardInterrupt:
        print(file=sys.stderr)  # the terminal shows ^C
    finally:
        server.stop()


def _draw(source: Path, options: ViewOptions) -> None:
    """Serve a page to draw regions on a recording without a run."""
    from tg4mm.core.regions import read_regions
    from tg4mm.show.view.desk import Desk

    if not source.exists():
        raise Tg4mmError(f"{source}: does not exist")
    file = options.regions or Path(f"{source.resolve().stem}-regions.json")
    desk = Desk(source, file, read_regions(file) if file.is_file() else None, options.port, options.fps)
    _serve(desk, Path.cwd() if options.open else None)


def _session(run: Path, options: ViewOptions) -> Session:
    from tg4mm.core.magnification import Magnification, check_band
    from tg4mm.run import Run
    from tg4mm.show.view.scene import open_scene
    from tg4mm.show.view.session import DisplaySettings, PlaybackClock, Session, slow_enough

    scene = open_scene(Run.open(run))
    bands = [band for band in options.bands if band is not None]
    if scene.motion is not None:
        bands = [check_band(band, scene.motion.fps) for band in bands]
    plan = Magnification.of(scene.alpha_to_see() if options.alpha is None else options.alpha, *bands)
    strongest, speed = scene.strongest(plan), 1.0
    if strongest is not None and scene.motion is not None:
        speed = slow_enough(float(scene.motion.freqs_hz[strongest]))
    look = DisplaySettings(plan, beside=scene.duration > 0)
    return Session(scene, look, PlaybackClock(scene.duration, speed=speed, playing=scene.duration > 0))


def export(options: ExportOptions) -> None:
    """Run `tg4mm export`."""
    _check_export(options)
    from tg4mm.run import Run
    from tg4mm.show.export.formats import export_spz
    from tg4mm.show.export.splat import export_ply
    from tg4mm.show.web.write import export_html

    opened, baked = Run.open(options.run), options.low_pass is LowPass.baked
    linear = options.low_pass is LowPass.linear
    if options.format is Format.ply:
        export_ply(opened, options.out, baked, linear)
    elif options.format is Format.html:
        export_html(opened, options.out)
    elif options.is_at_rest:
        export_spz(opened, options.out, baked, linear)
        _note("spz holds no motion: this is the scene at rest; a folder as --out takes a sequence")
    else:
        _export_magnified(opened, options, baked)
    print(options.out)


def _export_magnified(run: Run, options: ExportOptions, baked: bool) -> None:
    from tg4mm.show.export.formats import export_gltf, export_spz_sequence, export_usd
    from tg4mm.show.export.splat import export_ply_sequence
    from tg4mm.show.render.sequence import RenderRequest

    out, timesteps = options.out, options.timesteps
    plan = magnified(run, options.alpha or [0.0], options)
    request = RenderRequest(plan).checked()
    check_magnified(run, plan, options.allow_empty_band)
    warn_too_far(run, plan)
    if options.format is Format.gltf:
        export_gltf(run, out, plan, baked)
    elif options.format is Format.usd:
        export_usd(run, out, request, timesteps, baked)
    elif options.format is Format.spz:
        written = export_spz_sequence(run, out, request, timesteps, baked)
        _note(f"spz holds no motion: {written} files, one for each timestep")
    else:
        export_ply_sequence(run, out, request, timesteps, baked)


def _check_export(options: ExportOptions) -> None:
    """Raise Tg4mmError for an option that does not apply to the format."""
    o = options
    values = (o.alpha, o.bands, o.method, o.filter, o.timesteps)
    given = [name for name, value in zip(_MAGNIFIED, values, strict=True) if value not in (None, ())]
    taken = () if o.is_at_rest else _TAKEN.get(o.format, ())
    if wrong := [name for name in given if name not in taken]:
        reason = "a .spz file contains the scene at rest; give a folder" if o.is_at_rest else _HOLDS[o.format]
        formats = [one.value for one, names in _TAKEN.items() if all(name in names for name in wrong)]
        verb = "belongs" if len(wrong) == 1 else "belong"
        raise Tg4mmError(f"{' and '.join(wrong)} {verb} to --format {', '.join(formats)}; {reason}")
    if o.format is Format.html and o.low_pass is not LowPass.baked:
        raise Tg4mmError(
            f"--low-pass {o.low_pass.value}: not for html, which applies the low-pass when drawing; leave it out"
        )
    if o.low_pass is LowPass.linear and o.format is not Format.ply and not o.is_at_rest:
        raise Tg4mmError(f"--low-pass linear: for --format ply, or spz at rest, not for {o.format.value}")
    check_paired(o.alpha or [0.0], o.bands)
    _ = o.temporal_filter  # raises


def _note(line: str) -> None:
    print(line, file=sys.stderr)
