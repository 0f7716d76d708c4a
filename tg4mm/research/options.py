"""Options of `tg4mm evaluate`, `demo` and `bench`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.options import (
    REQUIRED,
    RUN,
    Device,
    MagnifyOptions,
    argument,
    device_option,
    option,
    parse_alphas,
    settings_option,
)

METHODS = "modal,paper-tuned,tracking,phase-2d"


def alphas_option() -> Any:
    """Return the option --alphas."""
    about = "Magnification factors, e.g. 5,10,20,50. [default: all with ground truth]"
    return option(None, about, metavar="A,A,…", given=str | None, into=parse_alphas)


def lpips_option() -> Any:
    """Return the option --lpips-weights."""
    about = "Local file(s) with the AlexNet trunk and LPIPS heads; LPIPS is omitted without them."
    return option((), about)


@dataclass(frozen=True, kw_only=True)
class DemoOptions:
    """Render a small scene, train, magnify and score: an example without own data.

    Renders a vibrating scene in Blender, trains, magnifies the motion by α = 20, compares it with the ground truth,
    exports a splat file, and writes OUT/report.html.
    """

    out: Path = option(Path("demo"), "Folder for all results; finished steps are not repeated.")
    size: int = option(128, "Width and height of the pictures, 16 to 4096.", unit="pixels")
    full: bool = option(False, "Render with 96 samples per pixel instead of 32: less noise, twice the time.")


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions(MagnifyOptions):
    """Score a run against its dataset's ground truth.

    Prints PSNR (dB), SSIM, FLIP and LPIPS on the test cameras, and the displacement error. Beside them stand the scores
    of "nothing moves" and, if the exact motion is known, of the ceiling. With --device cuda the GPU renders the
    pictures; metrics are computed on the CPU.
    """

    run: Path = argument("RUN", RUN)
    alphas: Sequence[float] | None = alphas_option()
    out: Path | None = option(None, "JSON file to write. [default: RUN/metrics.json]")
    lpips_weights: tuple[Path, ...] = lpips_option()
    device: Device = device_option()


@dataclass(frozen=True, kw_only=True)
class TruthOptions:
    """Write a dataset's truth as optical flow, part masks, occlusion and tracks of points.

    DATASET/truth/flow, parts, occlusion, parts.json, tracks.npz, of the test views, not magnified: docs/conventions.md.
    """

    dataset: Path = argument("DATASET", "Dataset folder with per-pixel truth of its test views.")


@dataclass(frozen=True, kw_only=True)
class ReleaseOptions:
    """Write a dataset card and checksums, to share datasets.

    DIR/README.md: what the datasets are; DIR/SHA256SUMS: of every file.
    """

    folder: Path = argument("DIR", "Folder with datasets, at any depth.")
    version: str = option("1", "Version of the data.")


@dataclass(frozen=True, kw_only=True)
class VerifyOptions:
    """Check every file of datasets against SHA256SUMS.

    A line for each file that is missing, changed or not listed; exit code 1 if there is any.
    """

    folder: Path = argument("DIR", "Folder with SHA256SUMS.")


class SameTime(StrEnum):
    """Condition for training a paper preset once more, for as long as modal took."""

    needed = "needed"
    always = "always"
    never = "never"


def _benchmark_alphas(text: str | None) -> tuple[float, ...] | None:
    alphas = parse_alphas(text)
    if alphas is not None and any(not 0 <= alpha < float("inf") for alpha in alphas):
        raise Tg4mmError(f"--alphas {text!r}: expected numbers of at least 0")
    return alphas


@dataclass(frozen=True, kw_only=True)
class BenchOptions:
    """Options of all parts of a benchmark."""

    external: tuple[str, ...] = option(
        (),
        "Pictures of another method, DIR/<dataset's name>/magnified/x005/000/test/r_000.png …, or its displacements, "
        "DIR/<dataset's name>/displacement.npz; may be repeated. docs/protocol.md.",
        metavar="NAME=DIR",
    )
    alphas: str | None = option(
        None, "Magnification factors, e.g. 5,10,20,50. [default: all with ground truth]", metavar="A,A,…"
    )
    lpips_weights: tuple[Path, ...] = lpips_option()
    md_vqa: Path | None = option(None, "Checkout of MD-VQA with its weights; MD-VQA is omitted without it.")
    fast_vqa: Path | None = option(
        None, "Checkout of FAST-VQA with its weights; FAST-VQA is omitted without it."
    )
    vqa_python: str = option("python3", "Python interpreter for MD-VQA and FAST-VQA.")
    device: Device = device_option()

    @property
    def alphas_list(self) -> tuple[float, ...] | None:
        """The magnification factors, None for all. Raises Tg4mmError for a negative one."""
        return _benchmark_alphas(self.alphas)


@dataclass(frozen=True, kw_only=True)
class WholeBenchOptions(BenchOptions):
    """Compare methods with ground truth: the benchmark."""

    preset: str | None = option(
        None,
        "The whole benchmark from nothing: smoke (one scene, minutes), small (eight scenes at 128×128), dev and test "
        "(sets whose pictures contain the exact motion; test with other motions, cameras and seeds), "
        "paper (512×512), mic-512 (one scene at 512×512).",
    )
    out: Path | None = option(None, "With --preset: folder for data, runs and pages.")
    dry_run: bool = option(False, "With --preset: print the commands, one per line, without running them.")


@dataclass(frozen=True, kw_only=True)
class JobsOptions(BenchOptions):
    """Options of the commands that run methods on datasets."""

    out: Path = option(
        REQUIRED, "Folder for runs, figures, tables and pictures; an unfinished one is resumed."
    )
    methods: str = option(
        METHODS,
        "Some of modal, paper-tuned, paper (presets of tg4mm train), tracking, 4dgs, sc-gs, per-frame, 3dmm, phase-2d, "
        "linear-2d.",
        metavar="M,M,…",
    )
    band: bool = option(
        True,
        "Magnify the motion's frequencies ± 1.5 Hz, or all frequencies.",
        name="--band-around-motion",
        off="--all-frequencies",
    )
    settings: Mapping[str, str] = settings_option(
        "A setting of tg4mm train for every run that has it, e.g. space.iterations=500; may be repeated."
    )


@dataclass(frozen=True, kw_only=True)
class ScenesOptions(JobsOptions):
    """Run and score every method on every dataset.

    Writes OUT/results.json, OUT/results.md, plots and OUT/tables/*.tex anew after every job, OUT/results.html at
    the end: SSIM over α beside "nothing moves" and the ceiling, and the other metrics of docs/protocol.md; displacement
    error and static leak (relative to the rms motion), seconds of each stage, peak memory in MiB. What fails is listed,
    and the rest goes on. OUT/runs holds the runs and pictures.
    """

    datasets: tuple[Path, ...] = argument(
        "DATASET…",
        "Dataset folders with ground truth (tg4mm generate), or NAME=DIR where two folders have one name.",
    )
    same_time: SameTime = option(
        SameTime.needed,
        "Train a paper preset once more with its iterations scaled to the seconds that modal took: where its own took "
        "less (needed), always, or never.",
    )
    collect: bool = option(False, "Run nothing; write the tables of finished jobs and list unfinished ones.")


@dataclass(frozen=True, kw_only=True)
class JobOptions(JobsOptions):
    """Run one method on one dataset, as a part of bench scenes.

    Jobs of one OUT may run at once, on any machine that sees the folder. Done again, nothing happens.
    """

    dataset: Path = argument("DATASET", "Dataset folder with ground truth, or NAME=DIR.")
    method: str = argument("METHOD", "One of tg4mm bench scenes --methods, or the NAME of --external.")
