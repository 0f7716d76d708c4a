"""`tg4mm bench`: the benchmark's tables."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tg4mm.cli.device import Device, DeviceOption
from tg4mm.cli.evaluate import parse_alphas
from tg4mm.cli.train import split_settings
from tg4mm.core.errors import Tg4mmError


def truth(
    dataset: Annotated[Path, typer.Argument(help="Dataset folder with per-pixel truth of its test views.")],
) -> None:
    """Write a dataset's truth as optical flow, part masks, occlusion and tracks of points.

    DATASET/truth/flow, parts, occlusion, parts.json, tracks.npz, of the test views, not magnified: docs/conventions.md.
    """
    from tg4mm.research.bench.truth_files import write_truth

    typer.echo("\n".join(map(str, write_truth(dataset))))


def release(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder with datasets, at any depth.")],
    version: Annotated[str, typer.Option(help="Version of the data.")] = "1",
) -> None:
    """Write the card and the checksums with which datasets are passed on.

    DIR/README.md: what the datasets are; DIR/SHA256SUMS: of every file.
    """
    from tg4mm.research.bench.release import release as write

    typer.echo("\n".join(map(str, write(folder, version))))


def verify(folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder with SHA256SUMS.")]) -> None:
    """Check every file of datasets against SHA256SUMS.

    A line for each file that is missing, changed or not listed; exit code 1 if there is any.
    """
    from tg4mm.research.bench.release import verify as check

    wrong = check(folder)
    typer.echo("\n".join(wrong) if wrong else f"{folder}: every file is as it was")
    if wrong:
        raise typer.Exit(1)


class SameTime(StrEnum):
    """When a paper preset is trained once more, for as long as modal took."""

    needed = "needed"
    always = "always"
    never = "never"


Datasets = Annotated[
    list[Path],
    typer.Argument(
        metavar="DATASET…",
        help="Dataset folders with ground truth (tg4mm generate), or NAME=DIR where two folders have one name.",
    ),
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
    typer.Option(help="Local file(s) with the AlexNet trunk and LPIPS heads; LPIPS is omitted without them."),
]
Banded = Annotated[
    bool,
    typer.Option(
        "--band-around-motion/--all-frequencies",
        help="Magnify the motion's frequencies ± 1.5 Hz, or all frequencies.",
    ),
]


Methods = Annotated[
    str,
    typer.Option(
        metavar="M,M,…",
        help="Some of modal, paper-tuned, paper (presets of tg4mm train), tracking, 4dgs, sc-gs, per-frame, 3dmm, "
        "phase-2d, linear-2d.",
    ),
]
Outside = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=DIR",
        help="Pictures of another method, DIR/<dataset's name>/magnified/x005/000/test/r_000.png …, or its "
        "displacements, DIR/<dataset's name>/displacement.npz; may be repeated. docs/protocol.md.",
    ),
]
MdVqa = Annotated[
    Path | None, typer.Option(help="Checkout of MD-VQA with its weights; MD-VQA is omitted without it.")
]
FastVqa = Annotated[
    Path | None, typer.Option(help="Checkout of FAST-VQA with its weights; FAST-VQA is omitted without it.")
]
VqaPython = Annotated[str, typer.Option(help="Python interpreter for MD-VQA and FAST-VQA.")]


if TYPE_CHECKING:
    from tg4mm.research.bench.request import Plan
    from tg4mm.research.bench.scenes import ScenesRequest

bench = typer.Typer(
    no_args_is_help=True,
    invoke_without_command=True,
    help="Compare methods with ground truth: the benchmark.",
    rich_markup_mode=None,
)


@bench.callback()
def whole(
    context: typer.Context,
    preset: Annotated[
        str | None,
        typer.Option(
            help="The whole benchmark from nothing: smoke (one scene, minutes), small (eight scenes at 128×128), dev "
            "and test (the same with two motions each and three seeds; test with other motions, cameras and seeds), "
            "small-dev and small-test (the same at 64×64), paper (512×512), mic-512 (one scene at 512×512)."
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="With --preset: folder for data, runs and pages.")] = None,
    external: Outside = None,
    alphas: Alphas = None,
    lpips_weights: Lpips = None,
    md_vqa: MdVqa = None,
    fast_vqa: FastVqa = None,
    vqa_python: VqaPython = "python3",
    device: DeviceOption = Device.cpu,
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run", help="With --preset: print the commands, one per line, without running them."
        ),
    ] = False,
) -> None:
    if context.invoked_subcommand is not None:
        sources = (context.get_parameter_source(name) for name in context.params)
        if any(source is not None and source.name == "COMMANDLINE" for source in sources):
            raise Tg4mmError(
                f"options before {context.invoked_subcommand}: give them after it, and no --preset"
            )
        return
    if preset is None or out is None:
        raise Tg4mmError("--preset and --out are needed together, or one of scenes, job")
    from tg4mm.research.bench.presets import Choices, run_preset, steps_of
    from tg4mm.research.bench.scored import checkouts
    from tg4mm.research.evaluate.lpips import load_lpips

    _plan(alphas, True, lpips_weights, device)
    checkouts({"md_vqa": md_vqa, "fast_vqa": fast_vqa}, vqa_python)
    if lpips_weights:
        load_lpips(lpips_weights)
    choices = Choices(
        tuple(external or ()),
        alphas or "",
        "" if device is Device.cpu else device.value,
        tuple(map(str, lpips_weights or ())),
        str(md_vqa or ""),
        str(fast_vqa or ""),
        vqa_python if md_vqa or fast_vqa else "",
    )
    choices.check()
    steps = steps_of(preset, str(out), choices=choices)
    if dry_run:
        typer.echo("\n".join(shlex.join(step.command) for step in steps))
        return
    page = out / "bench" / "results.html"
    before = page.stat().st_mtime_ns if page.is_file() else None
    failed = run_preset(preset, out, choices, _say)
    if page.is_file() and page.stat().st_mtime_ns != before:
        typer.echo(page)
    if failed:
        raise typer.Exit(1)


@bench.command()
def scenes(
    datasets: Datasets,
    out: Out,
    methods: Methods = "modal,paper-tuned,tracking,phase-2d",
    external: Outside = None,
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
    md_vqa: MdVqa = None,
    fast_vqa: FastVqa = None,
    vqa_python: VqaPython = "python3",
    goals: Annotated[
        Path | None,
        typer.Option(help="Also write a Markdown file that lists which of the project's goals are met."),
    ] = None,
    device: DeviceOption = Device.cpu,
    collect: Annotated[
        bool,
        typer.Option(
            "--collect", help="Run nothing; write the tables of finished jobs and list unfinished ones."
        ),
    ] = False,
) -> None:
    """Run and score every method on every dataset.

    Writes OUT/results.json, OUT/results.md, plots and OUT/tables/*.tex anew after every job, OUT/results.html at
    the end: SSIM over α beside "nothing moves" and the ceiling, and the other metrics of docs/protocol.md; displacement
    error and static leak (relative to the rms motion), seconds of each stage, peak memory in MiB. What fails is listed,
    and the rest goes on. OUT/runs holds the runs and pictures.
    """
    from tg4mm.research.bench.pages.markdown import goals_page
    from tg4mm.research.bench.scenes import run_scenes

    if goals is not None and goals.is_dir():
        raise Tg4mmError(f"--goals {goals}: is a folder; expected a file such as {goals / 'goals.md'}")
    request = _request(
        methods,
        external,
        alphas,
        band,
        same_time,
        settings,
        lpips_weights,
        (md_vqa, fast_vqa, vqa_python),
        device,
    )
    results = run_scenes(datasets, out, replace(request, collect=collect), _say)
    if goals is not None:
        from tg4mm.research.bench.folder import write_text

        write_text(goals, goals_page(results))
    typer.echo(out / "results.html")
    _exit_with(results, out)


def _exit_with(results: Mapping[str, Any], out: Path) -> None:
    if results["failed"]:
        _say(f"{len(results['failed'])} failed; see the head of {out / 'results.md'}")
        raise typer.Exit(1)


@bench.command()
def job(
    dataset: Annotated[Path, typer.Argument(help="Dataset folder with ground truth, or NAME=DIR.")],
    method: Annotated[
        str, typer.Argument(help="One of tg4mm bench scenes --methods, or the NAME of --external.")
    ],
    out: Out,
    methods: Methods = "modal,paper-tuned,tracking,phase-2d",
    external: Outside = None,
    alphas: Alphas = None,
    band: Banded = True,
    settings: Settings = None,
    lpips_weights: Lpips = None,
    md_vqa: MdVqa = None,
    fast_vqa: FastVqa = None,
    vqa_python: VqaPython = "python3",
    device: DeviceOption = Device.cpu,
) -> None:
    """Run one method on one dataset, as a part of bench scenes.

    Jobs of one OUT may run at once, on any machine that sees the folder. Done again, nothing happens.
    """
    from tg4mm.research.bench.methods.known import METHODS
    from tg4mm.research.bench.scenes import run_one

    if method in METHODS and method not in methods.split(","):
        methods = ",".join(filter(None, (methods, method)))
    vqa = md_vqa, fast_vqa, vqa_python
    never = SameTime.never
    request = _request(methods, external, alphas, band, never, settings, lpips_weights, vqa, device)
    typer.echo(run_one(dataset, method, out, request))


def _request(
    methods: str,
    external: list[str] | None,
    alphas: str | None,
    band: bool,
    same_time: SameTime,
    settings: list[str] | None,
    lpips_weights: list[Path] | None,
    vqa: tuple[Path | None, Path | None, str],
    device: Device,
) -> ScenesRequest:
    plan = _plan(alphas, band, lpips_weights, device)
    given = split_settings(settings or [])
    from tg4mm.research.bench.methods.known import checked_names, parse_external, settings_of
    from tg4mm.research.bench.scenes import ScenesRequest
    from tg4mm.research.bench.scored import checkouts

    names = checked_names(methods.split(",")) if methods or not external else ()
    return ScenesRequest(
        methods=names,
        settings=settings_of(given, names),
        external=parse_external(external or []),
        same_time=same_time.value,
        plan=plan,
        vqa=checkouts({"md_vqa": vqa[0], "fast_vqa": vqa[1]}, vqa[2]),
    )


for _command in (truth, release, verify):
    bench.command()(_command)


def _plan(alphas: str | None, band: bool, lpips_weights: list[Path] | None, device: Device) -> Plan:
    wanted = parse_alphas(alphas)
    if wanted is not None and any(not 0 <= a < float("inf") for a in wanted):
        raise Tg4mmError(f"--alphas {alphas!r}: expected numbers of at least 0")
    from tg4mm.fit.device import check_device
    from tg4mm.research.bench.request import Plan

    check_device(device.value)
    return Plan(
        alphas=None if wanted is None else tuple(wanted),
        banded=band,
        lpips_weights=tuple(lpips_weights or ()),
        device=device.value,
    )


def _say(text: str) -> None:
    typer.echo(text, err=True)
