"""The report of a run: gathering what it shows, the page, and the page as PDF by a browser of this machine."""

import logging
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from tg4mm.capture import Capture, load_capture
from tg4mm.capture.look import LookLine
from tg4mm.core import __version__
from tg4mm.core.errors import RunError
from tg4mm.core.extras import install
from tg4mm.core.files import write_atomic
from tg4mm.core.magnification import Magnification, check_band
from tg4mm.core.pages.page import Block, Figure, Page, Section, Table, Text, picture, render_page
from tg4mm.core.progress import progress
from tg4mm.run import Run
from tg4mm.run.stages import look_of
from tg4mm.run.tensor_file import model_hash
from tg4mm.show.options import ReportOptions
from tg4mm.show.regions import REGIONS_ALT, composite_figure, region_picture
from tg4mm.show.report.closing import accuracy_section, commands_section, cost_section, settings_section
from tg4mm.show.report.figures import videos
from tg4mm.show.report.sections import capture_section, measured, motion_section, sensors_section
from tg4mm.show.report.sources import choose_alpha, contact_images, gather_view, load_model, metrics_of
from tg4mm.show.report.summary import Material, limits_section, stats, summary
from tg4mm.show.result.model import Length, percent, title_of, with_deviation
from tg4mm.show.result.read import result_from
from tg4mm.show.result.reading import reading_of
from tg4mm.show.result.requested import too_far

_NAMES = [
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "microsoft-edge",
    "msedge",
]
_PROGRAMS = "Google/Chrome/Application/chrome.exe", "Microsoft/Edge/Application/msedge.exe"
_APPLICATIONS = "Google Chrome", "Chromium", "Microsoft Edge"
_LONGEST = 300  # seconds
_LOG = logging.getLogger("tg4mm")
_HEADER = ["frequency (Hz)", "amplitude (px)", "damping ratio", "around pixel (x, y)", "change", "remark"]


def printer() -> str:
    """Return the browser that prints: Chromium, Chrome or Edge. Raises RunError if there is none."""
    found = [path for name in _NAMES if (path := shutil.which(name))]
    places = [Path(f"/Applications/{name}.app/Contents/MacOS/{name}") for name in _APPLICATIONS]
    places += [
        Path(os.environ[folder]) / name
        for folder in ("PROGRAMFILES", "PROGRAMFILES(X86)") if folder in os.environ for name in _PROGRAMS
    ]  # fmt: skip
    found += [str(place) for place in places if place.is_file()]
    path = found[0] if found else _of_playwright()
    if path is None:
        raise RunError(
            "--pdf: no Chromium, Chrome or Edge is on this machine; install one, or "
            f"{install('pdf')} && playwright install chromium"
        )
    return path


def _of_playwright() -> str | None:
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        return None
    with sync_playwright() as play:
        path = play.chromium.executable_path
    return path if Path(path).is_file() else None


def print_pdf(page: Path, browser: str) -> Path:
    """Print a page to PAGE.pdf with `browser`; videos become stills. Raises RunError if it prints nothing."""
    out = page.with_suffix(".pdf")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        printed = Path(folder) / "page.pdf"
        is_root = getattr(os, "geteuid", lambda: 1)() == 0
        sandbox = ["--no-sandbox"] if is_root else []  # Chromium refuses root one
        command = [
            browser, "--headless", "--disable-gpu", *sandbox, f"--user-data-dir={folder}/profile",
            "--no-pdf-header-footer", f"--print-to-pdf={printed}", page.resolve().as_uri(),
        ]  # fmt: skip
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_LONGEST, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise RunError(f"{out}: {browser} failed to print the PDF: {error}") from None
        if done.returncode or not printed.is_file():
            why = done.stderr.strip().splitlines()[-1:] or ["no message"]
            raise RunError(
                f"{out}: {browser} failed to print the PDF (exit code {done.returncode}): {why[0]}"
            )
        write_atomic(out, partial(shutil.copyfile, printed))
    return out


def write_report(run: Run, out: Path, options: ReportOptions | None = None) -> Path:
    """Write the report of `run` to the file `out`; returns it.

    Reads the pictures once for the sensors, and scores the run by `options.evaluate` if its dataset has ground truth
    and no metrics.json is newer than the model. Raises RunError for an unfinished run, foreign metrics, or a band
    without a mode; CaptureError for a bad dataset; MeasureError for a sensor that cannot be measured.
    """
    options = options or ReportOptions()
    _check_writable(out)
    train = load_capture(run.dataset)
    material = _material(run, train, options)
    files = {
        "Gaussians": run.path / "space.safetensors",
        "motion": run.path / "motion.safetensors",
        "dataset": run.dataset,
        **options.files,
    }
    text = render_page(_page(material, files, options))
    out.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(out, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return out


def _check_writable(out: Path) -> None:
    """Raise RunError, before minutes of work, if `out` cannot be written."""
    if out.is_dir():
        raise RunError(f"--out {out} is a folder; expected a file such as {out / 'report.html'}")
    there = next(p for p in (out.parent, *out.absolute().parents) if p.exists())
    if not there.is_dir() or not os.access(there, os.W_OK):
        raise RunError(f"--out {out}: {there} cannot be written")


def _material(run: Run, train: Capture, options: ReportOptions) -> Material:
    bands = () if options.band is None else (check_band(options.band, train.fps),)
    chosen = Magnification.of(1.0, *bands) if options.shown is None else options.shown.magnified.times(1.0)
    reading = reading_of(run)
    result = result_from(reading, options.band)
    model = load_model(reading, train, chosen)
    alpha, why_alpha = options.alpha if options.shown is None else options.shown.magnified.alpha, ""
    if alpha is None or model.motion is None:
        alpha, why_alpha = choose_alpha(reading, result.noise_px, chosen)
    view = gather_view(run, train, model, chosen.times(float(alpha)), options.shown)
    with progress("sensors", 1, "part", brief=True):
        measurement, why_no_sensors = options.measurement, ""
        if model.motion is not None and measurement is None:
            measurement, why_no_sensors = measured(run, options.sensors, options.band, options.scale)
    metrics = dict(options.metrics) if options.metrics is not None else metrics_of(run, options.evaluate)
    if metrics and metrics.get("format") != "tg4mm-metrics":
        raise RunError(f"metrics have the format {metrics.get('format')!r}, expected 'tg4mm-metrics'")
    warning = None if model.motion is None else too_far(run, view.magnified)
    if warning:
        _LOG.warning(warning)
    return Material(
        run, train, model, view, result, metrics, measurement, why_no_sensors, why_alpha, warning or "",
        options.orbit,
    )  # fmt: skip


def _page(m: Material, files: Mapping[str, Path], options: ReportOptions) -> Page:
    sections: list[Section] = []
    parts: tuple[Callable[[Material], Section | Sequence[Section]], ...] = (
        regions_section, motion_section, sensors_section, accuracy_section, limits_section, capture_section,
        settings_section, lambda m: cost_section(m, files),
        lambda m: commands_section(m, options.sensors, options.alpha),
    )  # fmt: skip
    with progress("page", len(parts) + 1, "parts") as update:
        lead = videos(m)
        for done, part in enumerate(parts, start=1):
            update(done)
            made = part(m)
            sections += [made] if isinstance(made, Section) else made
        update(len(parts) + 1)
    return Page(
        title=title_of(m.train),
        kicker="3D motion magnification, report of a run",
        summary=summary(m),
        stats=stats(m),
        lead=lead,
        sections=sections,
        footer=f"tg4mm {__version__}. Preset {m.run.preset}. Run {m.run.path}. Model SHA-256 "
        f"{model_hash(m.run.path)}. docs/protocol.md defines displacement error, ceiling and the other scores.",
    )


def regions_section(m: Material) -> list[Section]:
    """Return the regions' section of a flat capture; else []."""
    found = None if m.train.kind.sees_depth else look_of(m.run)
    if found is None:
        return []
    words = (
        f"The picture was cut into cells of {found.cell_px} pixels, each cell's shift was measured in every picture, "
        "and lines were sought region by region, the strongest first, each tested separately. Cells that small shifts "
        "do not explain are treated as independent motion and excluded from the fit."
    )
    where = Figure(
        [picture(region_picture(found, contact_images(m.train, 1)[0]), alt=REGIONS_ALT, photo=True)],
        "Coloured: cells that show a line, and its direction; the first colour is the strongest. Striped: independent "
        "motion. White frames: that, and passing objects.",
    )
    blocks: list[Block] = [Text(words), composite_figure(found), where]
    if found.lines:
        caption = (
            "Lines of the regions, the largest amplitude first; a remark says why a line may be an artefact."
        )
        blocks.append(Table(_HEADER, [_row(line) for line in found.lines], caption, left=len(_HEADER)))
    return [Section("Region by region", blocks)]


def _row(line: LookLine) -> list[str]:
    return [
        with_deviation(Length(line.hz, line.hz_deviation)),
        with_deviation(Length(line.amplitude_px, line.amplitude_deviation_px, bool(line.lost))),
        percent(line.damping, line.damping_deviation),
        f"({line.centre_px[0]:.0f}, {line.centre_px[1]:.0f})",
        line.change,
        line.mark,
    ]
