"""A report from a run, its dataset and its scores."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tg4mm import __version__
from tg4mm.capture import check_band, load_capture
from tg4mm.errors import RunError
from tg4mm.files import write_atomic
from tg4mm.modelhash import model_hash
from tg4mm.report.accuracy import accuracy_section
from tg4mm.report.closing import cost_section, next_section, total_seconds
from tg4mm.report.page import Page, render_page
from tg4mm.report.sections import capture_section, motion_section
from tg4mm.report.sources import choose_alpha, gather_view, load_model
from tg4mm.report.summary import Material, stats, summary, title_of, videos
from tg4mm.runs import Run


@dataclass(frozen=True)
class ReportOptions:
    """What a report shows beyond the run itself."""

    alpha: float | None = None  # None = the magnification nearest 20 that has ground truth
    band: tuple[float, float] | None = None  # Hz, magnified; None = every frequency
    orbit: Path | None = None  # a folder that render_orbit wrote, to show its video
    files: Mapping[str, Path] = field(
        default_factory=dict
    )  # further files or folders to list with their size


def write_report(
    run: Run, dataset: Path, metrics: dict[str, Any], out: Path, options: ReportOptions | None = None
) -> Path:
    """Write the report of `run` to the file `out`; `metrics` as `evaluate_run` returns them, {} for none.

    Raises RunError for a run without a space stage, metrics of another kind, or a band without a mode;
    CaptureError for a bad dataset.
    """
    options = options or ReportOptions()
    if metrics and metrics.get("format") != "tg4mm-metrics":
        raise RunError(f"metrics have the format {metrics.get('format')!r}, expected 'tg4mm-metrics'")
    train = load_capture(dataset)
    band = None if options.band is None else check_band(options.band, train.fps)
    model = load_model(run, train, band)
    alpha = choose_alpha(dataset, options.alpha) if model.motion is not None else 0.0
    view = gather_view(run, train, model, alpha, band)
    material = Material(run, train, model, view, metrics, band, total_seconds(run.log()), options.orbit)
    files = {
        "Gaussians": run.path / "space.safetensors",
        "motion": run.path / "motion.safetensors",
        "dataset": Path(dataset),
        **options.files,
    }
    text = render_page(_page(material, files))
    out.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(out, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return out


def _page(m: Material, files: Mapping[str, Path]) -> Page:
    return Page(
        title=title_of(m.train),
        kicker="3D motion magnification, report of a run",
        summary=summary(m),
        stats=stats(m),
        lead=videos(m),
        sections=[
            capture_section(m),
            motion_section(m),
            accuracy_section(m),
            cost_section(m, files),
            next_section(m),
        ],
        footer=(
            f"tg4mm {__version__}. Preset {m.run.preset}. Run {m.run.path}. "
            f"Model SHA-256 {model_hash(m.run.path)}. "
            "README.md, “How the numbers are measured”, defines displacement error, ceiling and the other scores."
        ),
    )
