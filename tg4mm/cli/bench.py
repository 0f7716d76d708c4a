"""`tg4mm bench`: the benchmark's tables and the paper's ablations."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tg4mm.cli.device import Device, DeviceOption
from tg4mm.cli.evaluate import parse_alphas
from tg4mm.cli.train import Preset, split_settings
from tg4mm.errors import Tg4mmError

if TYPE_CHECKING:
    from tg4mm.bench.measure import Plan

bench = typer.Typer(
    no_args_is_help=True,
    help="Measure presets against ground truth: the benchmark's tables, and the paper's ablations.",
    rich_markup_mode=None,
)


class SameTime(StrEnum):
    """When a paper preset is trained once more, for as long as modal took."""

    needed = "needed"
    always = "always"
    never = "never"


Datasets = Annotated[
    list[Path], typer.Argument(metavar="DATASET…", help="Dataset folders with ground truth (tg4mm generate).")
]
Out = Annotated[
    Path, typer.Option(help="Folder for runs, figures, tables and pictures; an unfinished one is resumed.")
]
Alphas = Annotated[
    str | None,
    typer.Option(
        metavar="A,A,…", help="Magnification factors, e.g. 5,10,20,50. [default: all with ground truth]"
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="A setting of tg4mm train for every run that has it, e.g. space.iterations=500; may be repeated.",
    ),
]
Lpips = Annotated[
    list[Path] | None,
    typer.Option(help="Local file(s) with AlexNet trunk and LPIPS heads; without them no LPIPS."),
]
Banded = Annotated[
    bool,
    typer.Option(
        "--band-around-motion/--all-frequencies",
        help="Magnify the motion's frequencies and 1.5 Hz on either side, or everything.",
    ),
]


@bench.command()
def scenes(
    datasets: Datasets,
    out: Out,
    presets: Annotated[
        str, typer.Option(metavar="P,P,…", help="Some of modal, paper-tuned, paper.")
    ] = "modal,paper-tuned",
    alphas: Alphas = None,
    band: Banded = True,
    same_time: Annotated[
        SameTime,
        typer.Option(
            help="Train a paper preset once more with its iterations scaled to the seconds that modal took: where its "
            "own took less (needed), always, or never."
        ),
    ] = SameTime.needed,
    settings: Settings = None,
    lpips_weights: Lpips = None,
    device: DeviceOption = Device.cpu,
) -> None:
    """Train every preset on every dataset and score it against ground truth.

    Writes OUT/results.json and OUT/results.md anew after every run: SSIM over α beside "nothing moves" and the ceiling,
    displacement error and static leak (relative to the rms motion), seconds of each stage, peak memory in MiB, and
    whether each goal is reached. OUT/runs holds the runs.
    """
    plan = _plan(alphas, band, lpips_weights, device)
    given = split_settings(settings or [])
    from tg4mm.bench.measure import checked_presets
    from tg4mm.bench.page import goals_table
    from tg4mm.bench.request import settings_by_preset
    from tg4mm.bench.scenes import ScenesRequest, run_scenes

    chosen = checked_presets(presets.split(","))
    request = ScenesRequest(chosen, settings_by_preset(given, chosen), same_time.value, plan)
    results = run_scenes(datasets, out, request, _say)
    typer.echo(goals_table(results))
    typer.echo(f"\n{out / 'results.md'}")


@bench.command()
def ablation(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="Which one; a wrong name lists those there are.")
    ],
    datasets: Datasets,
    out: Out,
    preset: Annotated[
        Preset | None,
        typer.Option(help="The preset that is varied, where the ablation can take more than one."),
    ] = None,
    alphas: Alphas = None,
    band: Banded = True,
    settings: Settings = None,
    lpips_weights: Lpips = None,
    device: DeviceOption = Device.cpu,
) -> None:
    """Vary one thing and compare: initialisation, decoder, residual, iterations, filter-phase, difference, smoothness,
    views, amplitude.

    Prints the table, and writes OUT/results.json, OUT/results.md and OUT/results.svg. amplitude generates its datasets
    from the given ones (pixels of the first training camera, 0.01 to 1) under OUT/sets, unless they are there.
    """
    plan = _plan(alphas, band, lpips_weights, device)
    given = split_settings(settings or [])
    from tg4mm.bench.ablate import run_ablation

    text = run_ablation(name, datasets, out, None if preset is None else preset.value, given, plan, _say)
    typer.echo(text)
    typer.echo(f"\n{out / 'results.md'}")


def _plan(alphas: str | None, band: bool, lpips_weights: list[Path] | None, device: Device) -> Plan:
    wanted = parse_alphas(alphas)
    if wanted is not None and any(not 0 <= a < float("inf") for a in wanted):
        raise Tg4mmError(f"--alphas {alphas!r}: expected numbers of at least 0")
    from tg4mm.bench.measure import Plan
    from tg4mm.device import check_device

    check_device(device.value)
    return Plan(
        alphas=None if wanted is None else tuple(wanted),
        banded=band,
        lpips_weights=tuple(lpips_weights or ()),
        device=device.value,
    )


def _say(text: str) -> None:
    typer.echo(text, err=True)
