"""`tg4mm bench`: the benchmark's tables."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tg4mm.cli.generated import application, command
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.options import Device
from tg4mm.research.options import (
    JobOptions,
    JobsOptions,
    ReleaseOptions,
    SameTime,
    ScenesOptions,
    TruthOptions,
    VerifyOptions,
    WholeBenchOptions,
)

if TYPE_CHECKING:
    from tg4mm.research.bench.presets import Choices
    from tg4mm.research.bench.request import BenchPlan
    from tg4mm.research.bench.scenes import ScenesRequest
    from tg4mm.research.options import BenchOptions

FAILED = 1


def truth(options: TruthOptions) -> None:
    """Run `tg4mm bench truth`."""
    from tg4mm.research.bench.truth_files import write_truth

    print("\n".join(map(str, write_truth(options.dataset))))


def release(options: ReleaseOptions) -> None:
    """Run `tg4mm bench release`."""
    from tg4mm.research.bench.release import release as write

    print("\n".join(map(str, write(options.folder, options.version))))


def verify(options: VerifyOptions) -> int:
    """Run `tg4mm bench verify`."""
    from tg4mm.research.bench.release import verify as check

    wrong = check(options.folder)
    print("\n".join(wrong) if wrong else f"{options.folder}: every file is as it was")
    return FAILED if wrong else 0


def whole(options: WholeBenchOptions) -> int:
    """Run `tg4mm bench --preset`."""
    if options.preset is None or options.out is None:
        raise Tg4mmError("--preset and --out are needed together, or one of scenes, job")
    from tg4mm.research.bench.presets import run_preset, steps_of
    from tg4mm.research.bench.scored import checkouts
    from tg4mm.research.evaluate.lpips import load_lpips

    _plan(options, True)
    checkouts({"md_vqa": options.md_vqa, "fast_vqa": options.fast_vqa}, options.vqa_python)
    if options.lpips_weights:
        load_lpips(options.lpips_weights)
    choices = _choices(options)
    choices.check()
    steps = steps_of(options.preset, str(options.out), choices=choices)
    if options.dry_run:
        print("\n".join(shlex.join(step.command) for step in steps))
        return 0
    page = options.out / "bench" / "results.html"
    before = page.stat().st_mtime_ns if page.is_file() else None
    failed = run_preset(options.preset, options.out, choices, _say)
    if page.is_file() and page.stat().st_mtime_ns != before:
        print(page)
    return FAILED if failed else 0


def _choices(options: WholeBenchOptions) -> Choices:
    from tg4mm.research.bench.presets import Choices

    return Choices(
        options.external,
        options.alphas or "",
        "" if options.device is Device.cpu else options.device.value,
        tuple(map(str, options.lpips_weights)),
        str(options.md_vqa or ""),
        str(options.fast_vqa or ""),
        options.vqa_python if options.md_vqa or options.fast_vqa else "",
    )


def scenes(options: ScenesOptions) -> int:
    """Run `tg4mm bench scenes`."""
    from tg4mm.research.bench.scenes import run_scenes

    out = options.out
    request = replace(_request(options), same_time=options.same_time.value, collect=options.collect)
    results = run_scenes(options.datasets, out, request, _say)
    print(out / "results.html")
    return _exit_code(results, out)


def _exit_code(results: Mapping[str, Any], out: Path) -> int:
    if not results["failed"]:
        return 0
    _say(f"{len(results['failed'])} failed; see the head of {out / 'results.md'}")
    return FAILED


def job(options: JobOptions) -> None:
    """Run `tg4mm bench job`."""
    from tg4mm.research.bench.methods.known import METHODS
    from tg4mm.research.bench.scenes import run_one

    methods = options.methods
    if options.method in METHODS and options.method not in methods.split(","):
        methods = ",".join(filter(None, (methods, options.method)))
    request = _request(replace(options, methods=methods))
    print(run_one(options.dataset, options.method, options.out, request))


def _request(options: JobsOptions) -> ScenesRequest:
    plan = _plan(options, options.band)
    from tg4mm.research.bench.methods.known import checked_names, parse_external, settings_of
    from tg4mm.research.bench.scenes import ScenesRequest
    from tg4mm.research.bench.scored import checkouts

    names = checked_names(options.methods.split(",")) if options.methods or not options.external else ()
    return ScenesRequest(
        methods=names,
        settings=settings_of(options.settings, names),
        external=parse_external(list(options.external)),
        same_time=SameTime.never.value,
        plan=plan,
        vqa=checkouts({"md_vqa": options.md_vqa, "fast_vqa": options.fast_vqa}, options.vqa_python),
    )


def _plan(options: BenchOptions, banded: bool) -> BenchPlan:
    alphas = options.alphas_list
    from tg4mm.fit.device import check_device
    from tg4mm.research.bench.request import BenchPlan

    check_device(options.device.value)
    return BenchPlan(
        alphas=alphas, banded=banded, lpips_weights=options.lpips_weights, device=options.device.value
    )


def _say(text: str) -> None:
    print(text, file=sys.stderr)


COMMANDS = {
    "scenes": command(ScenesOptions, scenes),
    "job": command(JobOptions, job),
    "truth": command(TruthOptions, truth),
    "release": command(ReleaseOptions, release),
    "verify": command(VerifyOptions, verify),
}
app = application("bench", WholeBenchOptions.__doc__ or "", sort_key=99)
app.default(command(WholeBenchOptions, whole))
for _rank, (_name, _call) in enumerate(COMMANDS.items()):
    app.command(_call, name=_name, sort_key=_rank)
