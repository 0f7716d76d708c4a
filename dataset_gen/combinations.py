"""Which options go together: one that would change nothing is refused, not ignored."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from typing import Any

from .arguments import ALL
from .cameras import SINGLE
from .errors import GenerateError

# What an animation, which is not rendered, has no use for.
_OF_PICTURES = (
    "samples",
    "points",
    "engine",
    "device",
    "images",
    "background",
    "sensor",
    "jpeg",
    "alphas",
    "truth",
    "shake",
    "exposure_drift",
    "flicker",
    "flicker_hz",
    "codec",
    "crf",
    "keep_video",
)
_OF_WORK = ("out", "prepare", "part", "finish", "parts", "processes")


def check_together(options: argparse.Namespace, values: Mapping[str, Any]) -> None:
    """Raises GenerateError, one line with the option and its value, for an option that would be ignored.

    Parameters: `options`, as parsed: what was not given is None; `values`, with the preset and the defaults.
    """
    for problem in (
        *_listing(options),
        *_work(options),
        *_source(options),
        *_cameras(options, values),
        *_pictures(options, values),
    ):
        raise GenerateError(problem)


def _listing(options: argparse.Namespace) -> Iterator[str]:
    if options.list and options.scene is not None:
        yield f"--list goes with --blend and --mesh, not with the scene {options.scene}"
    for name in ("save_blend", *_OF_WORK, *_OF_PICTURES) if options.list else ():
        if getattr(options, name) not in (None, False):
            yield f"{_given(options, name)}: --list only reads the file, it writes nothing"


def _work(options: argparse.Namespace) -> Iterator[str]:
    if options.processes is not None and options.processes < 0:
        yield f"--processes {options.processes} is negative"
    if options.parts is not None and (options.parts < 1 or not options.prepare):
        yield f"--parts {options.parts} goes with --prepare and is at least 1"
    if options.save_blend is None:
        if options.out is None and not options.list:
            yield "--out DIR is needed: the parent folder of the dataset"
        if options.processes and (options.prepare or options.finish):
            phase = "--prepare" if options.prepare else "--finish"
            yield f"--processes {options.processes}: {phase} renders nothing"
        return
    if options.scene == ALL:
        yield f"--save-blend {options.save_blend} takes one scene, not {ALL}"
    for name in (*_OF_WORK, *_OF_PICTURES):
        if getattr(options, name) not in (None, False):
            yield f"{_given(options, name)}: --save-blend only saves the animation, it renders nothing"


def _source(options: argparse.Namespace) -> Iterator[str]:
    if options.blend is None:
        for option, value in (("--frame", options.frame), ("--scene", options.blend_scene)):
            if value is not None:
                yield f"{option} {value} goes with --blend"
    if options.scene is not None and options.name is not None:
        yield f"--name {options.name} goes with --blend and --mesh"


def _cameras(options: argparse.Namespace, values: Mapping[str, Any]) -> Iterator[str]:
    kind = values["cameras"]
    if options.views is not None and kind in SINGLE:
        there = "the file's cameras are taken, all of them" if kind == "given" else "there is one camera"
        yield f"--views {options.views}: with --cameras {kind} {there}"
    if kind == "flat" and (options.test_views or 0) > 1:
        yield f"--test-views {options.test_views}: --cameras flat has one at most, the camera's own"
    if kind == "given" and options.blend is None and options.mesh is None:
        yield "--cameras given needs a scene of your own (--blend FILE) that holds cameras"
    if not values["test_views"]:
        if options.alphas:
            yield f"{_given(options, 'alphas')}: magnified truth is that of the test views, --test-views 0 leaves none"
        if options.truth == "test":
            yield "--truth test: --test-views 0 leaves none"


def _pictures(options: argparse.Namespace, values: Mapping[str, Any]) -> Iterator[str]:
    if options.device is not None and values["engine"] != "cycles":
        yield f"--device {options.device} is where Cycles runs; --engine {values['engine']} has no choice"
    if options.jpeg is not None and options.sensor in (None, "none"):
        yield f"--jpeg {options.jpeg} goes with --sensor"
    if options.flicker_hz is not None and not values["flicker"]:
        yield f"--flicker-hz {options.flicker_hz:g} goes with --flicker"
    if values["codec"] == "none":
        for name in ("crf", "keep_video"):
            if getattr(options, name) not in (None, False):
                yield f"{_given(options, name)} goes with --codec"


def _given(options: argparse.Namespace, name: str) -> str:
    """The option as it was given: "--part 1/2"."""
    value = getattr(options, name)
    if isinstance(value, tuple):
        value = ("/" if name == "part" else ",").join(f"{v:g}" for v in value)
    option = f"--{name.replace('_', '-')}"
    return option if value is True else f"{option} {value}"
