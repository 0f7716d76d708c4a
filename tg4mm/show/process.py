"""Makes numbers, pages and a magnified video from a video, in one folder; estimates the time; prints the result."""

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture import load_capture
from tg4mm.capture.pictures import read_once
from tg4mm.capture.sfm.clip import Clip, Sources, clip_frames, find_sources
from tg4mm.capture.sfm.config import SCENE_ONLY, SfmConfig, checked, files_of
from tg4mm.capture.sfm.reconstruct import reconstruct
from tg4mm.capture.video import video_info
from tg4mm.core.choices import Clock, Kind
from tg4mm.core.errors import RunError
from tg4mm.core.files import write_atomic
from tg4mm.core.magnification import Magnification, check_band
from tg4mm.core.pictures.decode import decode
from tg4mm.core.progress import few_lines
from tg4mm.core.untrusted import read_json
from tg4mm.core.work_folder import FolderStep, Say, WorkFolder, run_steps
from tg4mm.fit.motion.observations import check_band_resolved, frames_of
from tg4mm.run import Run
from tg4mm.run.train import train
from tg4mm.show.analyse.channel import AnalyseError
from tg4mm.show.analyse.results import analyse, write_analysis
from tg4mm.show.measure import Measurement, Sensor, measure, prepare
from tg4mm.show.measure.locate import check_pixel, check_sensors
from tg4mm.show.measure.plots import PLOTS
from tg4mm.show.measure.sensors import OF_PICTURE, checked_names, drawn_sensors
from tg4mm.show.measure.write import MARK, REGIONS, write_measurement
from tg4mm.show.measure.write import work_folder as measured_folder
from tg4mm.show.options import ProcessOptions, ReportOptions
from tg4mm.show.render.cameras import Camera, capture_cameras, orbit
from tg4mm.show.render.sequence import RECORD as RENDER_RECORD
from tg4mm.show.render.sequence import RenderRequest, render_orbit, render_sequence
from tg4mm.show.render.sequence import record as record_of
from tg4mm.show.report.sources import Shown, shown_of
from tg4mm.show.report.write import write_report
from tg4mm.show.result.model import Length, Result, Vibration, amount, with_deviation
from tg4mm.show.result.read import result_of
from tg4mm.show.result.requested import how_sure, refuse_empty
from tg4mm.show.web.write import export_html

# Processor seconds in measured runs: for each megapixel of all pictures (the model; then numbers, video and report),
# for each of one picture, and in any case. 600 pictures of 1920×1080 took 477 s and 8.5 GB, 300 of 960×540 3.8 GB, of
# 640×360 86 s and 1.8 GB, 120 of 240×160 26 s and 0.8 GB. In 3D 262 pictures of 600×800 took 1,106 s and 7.4 GB.
_FLAT_S = 0.25, 60.0, 45.0
_DEEP_S = 6.5 + 1.34, 0.0, 120.0
# GB for all pictures, up to so many megapixels; for each megapixel of one picture
_FLAT_GB, _DEEP_GB, _ALL_MP = (1.3, 3.2), (1.4, 1.7), 150.0
# of the modes in 3D, in addition; up to so many megapixels, since the number of Gaussians is limited
_MODES_GB, _MODES_MP = 10.0, 0.5
_LEAST_GB = 0.6  # in any case
_NAMED = 2  # vibrations
RECORD, ANALYSIS = "process.json", "analysis"
ORBIT = 90  # pictures
LARGEST_PAGE = 10_000_000  # bytes
_AROUND = 0.5  # margin of a region's video over the region's size
_BAND_BINS = 1.5  # over the duration, to either side of a region's strongest line
# For a first answer: the fewest iterations for a scene of any size, and the Gaussians that they can place.
QUICK = {"space.iterations": "1000", "space.max_gaussians": "10000"}


def estimate_line(sources: Sources, config: SfmConfig) -> str:
    """Return a line with time and memory of all steps, estimated from number, size and kind of the pictures."""
    pictures, size = _pictures(sources, config)
    one = size[0] * size[1] / 1e6
    every = pictures * one
    has_depth = sources.sweep is not None or sources.photographs is not None or len(sources.clips) > 1
    has_depth = Kind(config.kind).sees_depth if config.kind is not None else has_depth
    of_all, of_one, always = _DEEP_S if has_depth else _FLAT_S
    seconds = of_all * every + of_one * one + always
    of_every, of_each = _DEEP_GB if has_depth else _FLAT_GB
    memory = _LEAST_GB + of_every * min(1.0, every / _ALL_MP) + of_each * one
    memory += _MODES_GB * min(one, _MODES_MP) if has_depth else 0.0
    what = "in 3D" if has_depth else "one camera, if fixed"
    return (
        f"{pictures} pictures of {size[0]}×{size[1]}, {what}: about {_about(seconds)} of processor time and "
        f"{memory:.1f} GB of memory"
    )


def _about(seconds: float) -> str:
    """Return a duration with at most two digits, such as 2 min for 90 s."""
    minutes = seconds / 60
    if minutes < 10:
        return f"{max(1, round(minutes))} min"
    return f"{round(minutes, -1):.0f} min" if minutes < 100 else f"{minutes / 60:.1f} h"


def _pictures(sources: Sources, config: SfmConfig) -> tuple[int, tuple[int, int]]:
    """Return the number of pictures, and their width and height."""
    first = [*sources.clips, *sources.every()][0]
    pixels = decode(first.pictures[0]) if first.pictures else next(iter(clip_frames(first))).pixels
    return sum(_count(clip, config) for clip in sources.every()), (pixels.shape[1], pixels.shape[0])


def _count(clip: Clip, config: SfmConfig) -> int:
    if clip.pictures:
        return len(clip.pictures)
    info = video_info(clip.path)
    if not info.duration_s:
        return max(info.total, 1)
    stop = info.duration_s if config.stop_s is None else min(config.stop_s, info.duration_s)
    return max(1, round(info.total * max(stop - config.start_s, 0.0) / info.duration_s))


def result_lines(result: Result, out: Path, opens: str) -> list[str]:
    """Return five lines: frequency, amplitude, position, unknown quantities, and the file to open."""
    found = sorted([*result.vibrations, *result.beside], key=lambda v: bool(v.doubt))[:_NAMED]
    more = len(result.vibrations) + len(result.beside) - len(found)
    others = f", and {more} more" if more else ""
    hz = [
        f"{with_deviation(Length(v.hz, v.deviation_hz))} Hz{' (in doubt)' if v.doubt else ''}" for v in found
    ]
    lines = [
        ("frequency", f"{'; '.join(hz)}{others}"),
        ("amplitude", "; ".join(_size(v, result) for v in found)),
        ("where", "; ".join(_where(v) for v in found)),
    ]
    if not found:
        nothing = "nothing vibrates" if result.n_timesteps > 1 else "a still scene: there is one timestep"
        floor = "" if result.noise_px is None else f"less than about {result.noise_px:.2g} px"
        lines = [("frequency", nothing), ("amplitude", floor or "none"), ("where", "nowhere")]
    rest = f" (and {len(result.cannot) - 1} more in the report)" if len(result.cannot) > 1 else ""
    lines += [("limits", f"{result.cannot[0]}{rest}" if result.cannot else "none known")]
    return [*(f"{name:<11}{text}" for name, text in lines), f"{'open':<11}{out / opens}"]


def _size(v: Vibration, result: Result) -> str:
    """Return the amplitude in millimetres if the scale is known, otherwise in pixels."""
    if result.unit_scale_m is None and v.pixels is not None:
        return f"{with_deviation(v.pixels)} px"
    return " ".join(amount(v.amplitude, result.unit_scale_m))


def _where(v: Vibration) -> str:
    if v.position_px is not None:
        return f"pixel {v.position_px[0]:.0f}, {v.position_px[1]:.0f}"
    return f"({', '.join(f'{c:.3g}' for c in v.position)})"


def process(source: Path, out: Path, options: ProcessOptions | None = None, say: Say = print) -> Path:
    """Make OUT from photographs or recordings: `dataset/`, `run/`, `measured/`, `magnified.mp4`, the pages.

    Finished steps are skipped, so that the same call continues after a kill, and one with other options repeats what
    they change; the folder of another request is kept under another name. Returns OUT. Raises Tg4mmError on bad input,
    RunError if OUT holds anything else than this function's files of the same source.
    """
    options = options or ProcessOptions()
    if options.only:
        if options.regions is None:
            raise RunError("--only names a region of a file: give --regions FILE")
        options.regions[options.only]
    checked(options.sfm)
    RenderRequest(Magnification(everywhere=options.alpha or 0.0)).checked()
    sources = find_sources(source, timed=options.sfm.fps is not None)
    pictures = files_of(sources)
    record = {"format": "tg4mm-process", "version": 1, "source": str(source.resolve())}
    folder = WorkFolder(out, RECORD, free=("done",))
    with folder.locked("processes into it"):
        folder.claim(record, {**record, "done": {}})
        say(estimate_line(sources, options.sfm))
        with few_lines(), read_once():
            run_steps(folder, record, _steps(source, out, options, pictures, say), say)
        if not options.all_files:
            _remove_pictures(out / "magnified")
        opens = "magnified.mp4" if options.quick or options.only else "report.html"
        for line in result_lines(result_of(Run.open(out / "run"), options.band), out, opens):
            say(line)
    return out


def _steps(source: Path, out: Path, options: ProcessOptions, pictures: Any, say: Say) -> list[FolderStep]:
    dataset, run, settings = out / "dataset", out / "run", options.sfm.settings()
    name = source.resolve().stem if source.is_file() else source.resolve().name
    scale = {key: settings.pop(key) for key in SCENE_ONLY}
    clock = {"fps": options.sfm.fps, "readout_s": options.sfm.readout_s}
    made: list[Measurement] = []  # in this call: the report needs no other
    trained = {**(QUICK if options.quick else {}), **options.settings}
    magnified: dict[str, Any] = {"alpha": options.alpha, "band": options.band}
    sensors = [*([s.name, repr(s)] for s in options.sensors), repr(options.regions), options.only]
    sensors = sensors if options.regions is not None else sensors[:-2]
    magnified |= {"only": repr(options.regions[options.only])} if options.only and options.regions else {}

    all_files = {"all_files": True} if options.all_files else {}
    largest = None if options.all_files else LARGEST_PAGE

    def with_band() -> dict[str, str]:
        """Return the settings, with the band if the fit depends on it."""
        if options.band is None or not _fits_by_band(dataset, options.band):
            return trained
        return {"motion.band": "{:g} {:g}".format(*options.band), **trained}

    def banded() -> dict[str, Any]:
        """Return the band if nothing was found in it, so that sensors depend on it."""
        low, high = options.band or (0.0, 0.0)
        found = options.band is None or any(low <= v.hz <= high for v in result_of(Run.open(run)).vibrations)
        return {} if found else {"band": options.band}

    def make() -> None:
        reconstruct(source, dataset, options.sfm, options.threads, name)

    def fit() -> None:
        _check_options(dataset, options)
        train(dataset, run, "modal", options.device, _for_kind(dataset, with_band()))

    def reported() -> Path:
        chosen = ReportOptions(
            alpha=options.alpha,
            band=options.band,
            sensors=_sensors(dataset, options),
            scale=None if options.regions is None else options.regions.scale,
            shown=_shown(Run.open(run), out, options),
            measurement=made[0] if made else None,
        )
        return write_report(Run.open(run), out / "report.html", chosen)

    steps = [
        FolderStep("dataset", "Poses and times", dataset / "scene.json", make, {"pictures": pictures, **settings},
             folder=dataset),
        FolderStep("scale", "Scale and rate", dataset / "scene.json", make, scale, ["dataset"], in_place=True),
        FolderStep("run", "The scene at rest and its motion", run / "space.safetensors", fit,
             lambda: {"settings": with_band(), "device": options.device, **clock}, ["dataset"], run),
        FolderStep("measured", "Measure", out / "measured",
             lambda: made.extend(_measure(run, out / "measured", options, say)),
             lambda: {"sensors": sensors, "quick": options.quick, **banded(), **all_files}, ["scale", "run"]),
        FolderStep("magnified", "The magnified video", out / "magnified", lambda: _magnify(run, out, options, say),
             {**magnified, **all_files}, ["run", "measured"] if options.only else ["run"],
             in_place=not options.all_files),
    ]  # fmt: skip
    pages = [
        FolderStep("report", "The report", out / "report.html", reported, {**magnified, "sensors": sensors},
             ["scale", "run"]),
        FolderStep("page", "The page to send", out / "page.html",
             lambda: export_html(Run.open(run), out / "page.html", largest, _if_there(out / "measured" / REGIONS)),
             all_files, ["scale", "run", "measured"]),
    ]  # fmt: skip
    return steps if options.quick or options.only else [*steps, *pages]


def _if_there(path: Path) -> Path | None:
    return path if path.is_file() else None


def _sensors(dataset: Path, options: ProcessOptions) -> list[Sensor]:
    """Return the requested and the drawn sensors, or the one of `only`."""
    if options.regions is None:
        return list(options.sensors)
    capture = load_capture(dataset)
    options.regions.check_size((capture.width, capture.height), dataset)
    cameras = [frame.name for frame in frames_of(capture)[1]]
    if options.only:
        return drawn_sensors(options.regions, cameras, [options.only])
    return checked_names([*options.sensors, *drawn_sensors(options.regions, cameras)])


def _check_options(dataset: Path, options: ProcessOptions) -> None:
    """Check band and sensors' cameras against the dataset, before minutes of training."""
    capture = load_capture(dataset)
    if options.band is not None:
        check_band(options.band, capture.fps)
        if capture.n_timesteps > 1:
            check_band_resolved(options.band, capture.n_timesteps / capture.fps)
    cameras = [frame.name for frame in frames_of(capture)[1]] if capture.n_timesteps > 1 else []
    for sensor in _sensors(dataset, options) if cameras else []:
        if sensor.region in OF_PICTURE:
            check_pixel(sensor, cameras, (capture.width, capture.height))


def _for_kind(dataset: Path, settings: Mapping[str, str]) -> dict[str, str]:
    """Return the settings, for a flat capture without the sizes of a first answer, since its fit takes seconds."""
    deep = load_capture(dataset).kind.sees_depth
    return {k: v for k, v in settings.items() if deep or QUICK.get(k) != v}


def _fits_by_band(dataset: Path, band: tuple[float, float]) -> bool:
    """Return whether a fit needs the band to include it; with fixed cameras of one clock it has every bin."""
    capture = load_capture(dataset)
    if capture.n_timesteps < 2:
        return False
    check_band(band, capture.fps)
    bins = np.arange(1, capture.n_timesteps // 2 + 1) * capture.fps / capture.n_timesteps
    return frames_of(capture)[0] != Clock.synchronous or not ((bins >= band[0]) & (bins <= band[1])).any()


def _measure(path: Path, out: Path, options: ProcessOptions, say: Say) -> list[Measurement]:
    """Write OUT/measured; returns the measurement, or none for a still scene."""
    run = Run.open(path)
    if run.load_motion() is None:
        out.mkdir(exist_ok=True)
        say(f"{out}: empty, since the scene is still")
        return []
    sensors = _sensors(run.dataset, options)
    check_sensors(run, sensors)
    scale = None if options.regions is None else options.regions.scale
    with measured_folder(out).locked("writes a measurement there"):
        found = measure(prepare(run), sensors or None, band=options.band, scale=scale)
        plots = PLOTS if options.all_files else PLOTS[:1]
        write_measurement(found, out, animate=not options.quick, plots=plots)
        _analyse(out, options.all_files, say)
    return [found]


def _analyse(measured: Path, all_files: bool, say: Say) -> None:
    """Write levels of displacement, velocity and acceleration, and spectra, into MEASURED/analysis."""
    out = measured / ANALYSIS
    try:
        found = analyse(measured)
        out.mkdir(exist_ok=True)
        write_analysis(found, out, plots=all_files)
    except AnalyseError as error:
        say(f"no {out}: {error}")


def _shown(run: Run, out: Path, options: ProcessOptions) -> Shown | None:
    """Return band and α of OUT/magnified.mp4; None without a vibration."""
    result = result_of(run, options.band)
    band = options.band or (_band_of(out / "measured", options.only) if options.only else result.band)
    if run.load_motion() is None or band is None:
        return None
    alpha = result.alpha if options.alpha is None else options.alpha
    return Shown(Magnification.of(alpha, band), out / "magnified")


def _magnify(path: Path, out: Path, options: ProcessOptions, say: Say) -> None:
    """Write OUT/magnified.mp4 for the strongest vibration's band, or print the reason why not."""
    run, folder, video = Run.open(path), out / "magnified", out / "magnified.mp4"
    shown = _shown(run, out, options)
    video.unlink(missing_ok=True)
    folder.mkdir(exist_ok=True)
    if shown is None:
        why = (
            "the scene is still"
            if run.load_motion() is None
            else f"no vibration was found{' in ' * bool(options.only)}{options.only}; --band LO HI magnifies a band "
            "anyway"
        )
        say(f"no {video}: {why}")
        return
    capture = load_capture(run.dataset)
    in_report = 0 if options.quick or options.only else shown_of(capture.n_timesteps, capture)
    request = RenderRequest(shown.magnified, kept=None if options.all_files else in_report).checked()
    if options.band is not None:
        refuse_empty(run, request.magnified)
        for line in how_sure(run, request.magnified):
            say(line)
    camera = _fixed_camera(run)
    if camera is None:
        centre = run.load_space().means.median(dim=0).values.numpy()
        cameras, kind = list(orbit(capture, ORBIT, centre)), "orbit"
    else:
        if options.only and options.regions is not None:
            camera = camera.cut(options.regions[options.only].corners, _AROUND)
        cameras, kind = [camera], "sequence"
    _remove_others(folder, record_of(run, request, cameras, kind))
    render = render_orbit if camera is None else render_sequence
    render(run, cameras, request, folder, device=options.device)
    made = next(folder.glob("*.mp4"), None)
    if made is None:
        raise RunError(f"{folder}: no video was written")
    if options.all_files:
        write_atomic(video, lambda temporary: shutil.copyfile(made, temporary))
    else:
        made.replace(video)
    (low, high), alpha = shown.magnified.limits[0], shown.magnified.alpha
    say(f"{video}: {1 + alpha:g} times the motion from {low:g} to {high:g} Hz")


def _remove_others(folder: Path, request: Mapping[str, Any]) -> None:
    """Remove another request's pictures from the magnified video's folder."""
    record = folder / RENDER_RECORD
    if record.exists() and read_json(record) != request:
        shutil.rmtree(folder)
        folder.mkdir()


def _remove_pictures(folder: Path) -> None:
    """Remove all but the render request from the magnified video's folder."""
    for path in folder.glob("*") if (folder / RENDER_RECORD).exists() else ():
        if path.is_dir():
            shutil.rmtree(path)
        elif path.name != RENDER_RECORD:
            path.unlink()


def _band_of(measured: Path, sensor: str) -> tuple[float, float] | None:
    """Return a band around the strongest peak of a measured sensor; None without a peak."""
    content = read_json(measured / MARK)
    found = next(s for s in content["sensors"] if s["name"] == sensor)
    if not found["peaks"]:
        return None
    strongest = max(found["peaks"], key=lambda p: p["main_amplitude"])
    hz, wide = strongest["frequency_hz"], max(_BAND_BINS / np.ptp(found["series"][0]["times_s"]), 0.01)
    return round(max(hz - wide, 0.0), 3), round(hz + wide, 3)


def _fixed_camera(run: Run) -> Camera | None:
    """Return the fixed camera with most pictures; None for a moving camera or a still scene."""
    capture = load_capture(run.dataset)
    counts = np.bincount(capture.camera_ids)
    most = int(np.argmax(counts))
    if capture.kind.moving or counts[most] < 2:
        return None
    return capture_cameras(capture.selected(np.flatnonzero(capture.camera_ids == most)))[0]
