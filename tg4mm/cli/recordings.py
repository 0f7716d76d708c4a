"""The commands that take recordings or a dataset (look, sfm, convert, train, process), or nothing (generate, demo)."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.options import read_drawn
from tg4mm.core.values import NOT_NEGATIVE, POSITIVE, Maybe, require

if TYPE_CHECKING:
    from tg4mm.capture.options import ConvertOptions, SfmOptions
    from tg4mm.research.options import DemoOptions
    from tg4mm.run.options import TrainOptions
    from tg4mm.show.look import LookText
    from tg4mm.show.options import LookOptions, ProcessCommand


def demo(options: DemoOptions) -> None:
    """Run `tg4mm demo`."""
    import torch  # noqa: F401  # what is missing is reported before a minute of rendering

    from tg4mm.research.demo import run_demo

    run_demo(options.out, options.size, options.full)


def generate() -> None:
    """Render a dataset with exact ground truth, in Blender."""  # for --help: the program calls `run_generate`


def run_generate(words: Sequence[str]) -> int:
    """Run `tg4mm generate`, whose options are the generator's own; return its exit code."""
    from tg4mm.research.generator import run_generator

    return run_generator(words)


def look(options: LookOptions) -> None:
    """Run `tg4mm look`."""
    _check_look(options)
    from tg4mm.capture.look import look as looked
    from tg4mm.capture.look.rows import with_rows
    from tg4mm.capture.sfm.clip import TimeWindow
    from tg4mm.show.look import LookText

    o, readout = options, options.readout or 0.0
    window = TimeWindow(o.start, math.inf if o.until is None else o.until)
    drawn = read_drawn(o.regions)
    found = looked(o.video, o.fps, window, drawn, o.keep_duplicates)
    if readout > (frame_ms := 1e3 / found.rate):
        raise Tg4mmError(
            f"--readout is {readout:g}, expected at most the {frame_ms:.4g} ms of a frame of {o.video.name}"
        )
    rows = with_rows(found, readout / 1e3)
    words = LookText(rows, o.video, o.fps, window, drawn, o.regions, o.keep_duplicates)
    print("\n".join([*words.lines(), str(_write_look(words, options))]))


def _check_look(options: LookOptions) -> None:
    fps, png, start, until = options.fps, options.png, options.start, options.until
    if fps is not None and not 0 < fps < 1e6:
        raise Tg4mmError(f"--fps is {fps:g}; expected a frame rate above 0 Hz")
    require("--readout", options.readout, Maybe(NOT_NEGATIVE), Tg4mmError)
    if png is not None and png.suffix.lower() != ".png":
        raise Tg4mmError(f"--png {png}: expected a name that ends in .png")
    require("--until", until, Maybe(POSITIVE), Tg4mmError)
    if not 0 <= start < (math.inf if until is None else until):
        given = f"--from {start:g}{'' if until is None else f' --until {until:g}'}"
        raise Tg4mmError(f"{given}: selects nothing; --from must be at least 0 and before --until")
    if options.video.is_dir() and (start or until is not None):
        raise Tg4mmError(
            "--from and --until apply to videos; for a folder, remove the pictures that you do not want"
        )
    if options.out is not None and options.out.exists() and not options.out.is_dir():
        raise Tg4mmError(f"--out {options.out}: is a file; expected a folder")
    if options.readout:
        _check_upright(options.video)


def _check_upright(video: Path) -> None:
    """Raise Tg4mmError for a video that is shown turned, whose rows are not read from top to bottom."""
    from tg4mm.capture.video import RECORDING_SUFFIXES, is_turned

    if video.is_file() and video.suffix.lower() in RECORDING_SUFFIXES and is_turned(video):
        raise Tg4mmError(
            f"--readout is for pictures whose rows are read from top to bottom, but those of {video.name} are turned "
            "when they are shown"
        )


def _write_look(words: LookText, options: LookOptions) -> Path:
    """Write the picture, and with --out the page and the numbers; return the file to open."""
    from tg4mm.show.look import write_json_file, write_page, write_picture

    out = options.out
    name = f"{options.video.resolve().stem}-look.png"
    picture = options.png or (Path(name) if out is None else out / "look.png")
    for folder in (out, picture.parent):
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
    write_picture(words, picture)
    if out is None:
        return picture
    write_json_file(words, out / "look.json")
    write_page(words, out / "look.html")
    return out / "look.html"


def sfm(options: SfmOptions) -> None:
    """Run `tg4mm sfm`."""
    from tg4mm.capture.options import sfm_config
    from tg4mm.capture.sfm.reconstruct import reconstruct

    config = sfm_config(options, options.length_file)
    report = reconstruct(options.source, options.out, config, options.threads)
    for line in _sfm_lines(report):
        print(line, file=sys.stderr)
    print(options.out)


def _sfm_lines(report: dict[str, Any]) -> list[str]:
    lines = []
    if "placed" in report:
        lines.append(
            f"{report['placed']} of {report['pictures']} pictures placed, {report['points']} points, "
            f"{report['reprojection_error_px']:.2f} px"
        )
    if "length" in report:
        found = report["length"]
        ends = " and ".join(f"({', '.join(f'{x:.4f}' for x in point)})" for point in found["points"])
        lines.append(
            f"length: {found['metres']:g} m between {ends} is {found['units']:.5g} units, "
            f"± {found['uncertainty_percent']:.2g} %"
        )
    return lines


def convert(options: ConvertOptions) -> None:
    """Run `tg4mm convert`."""
    from tg4mm.capture import load_capture
    from tg4mm.capture.convert import at_timesteps, split_of, write_colmap, write_nerfstudio
    from tg4mm.capture.options import Layout

    train = at_timesteps(load_capture(options.dataset), options.timesteps)
    if options.to is Layout.colmap:
        write_colmap(train, options.out)
    else:
        test = split_of(options.dataset, "test")
        sets = [train] if test is None else [train, at_timesteps(test, options.timesteps)]
        write_nerfstudio(sets, options.out)
    print(options.out)


def train(options: TrainOptions) -> None:
    """Run `tg4mm train`."""
    settings = options.all_settings()
    from tg4mm.run.train import train as train_run
    from tg4mm.show.result import lines_of, result_of

    run = train_run(options.dataset, options.out, options.preset, options.device.value, settings)
    print("\n".join(lines_of(result_of(run))))


def list_settings() -> int:
    """Print the settings of all presets; return the exit code."""
    from tg4mm.core.options import listed
    from tg4mm.run.preset import presets

    for preset, chosen in presets().items():
        print(f"--preset {preset}")
        print("\n".join(f"  {line}" for line in listed(chosen.defaults)))
    return 0


def process(options: ProcessCommand) -> None:
    """Run `tg4mm process`."""
    from tg4mm.run.train import parse_settings
    from tg4mm.show.process import process as processed

    parse_settings(options.settings)  # raises before hours of work
    processed(options.source, options.out, options, print)
