"""Conversion of parsed command-line options to settings."""

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from .arguments import ALL, ALPHAS, CLIPS, DEFAULTS, PRESETS, parser
from .cameras import SINGLE, CameraSetup
from .effects import Effects
from .errors import GenerateError
from .pictures import PictureFormat, Sensor
from .scenes import NAMES
from .settings import Settings, Source, motion_file
from .vibration import read_motion

__all__ = ["ALL", "ALPHAS", "DEFAULTS", "PRESETS", "Request", "parser", "request_from"]


@dataclass(frozen=True)
class Request:
    """A request of the command line."""

    sets: tuple[Settings, ...]  # one, or one for each built-in scene
    out: Path  # not used to save an animation
    count: int  # render processes at once, 0: one per core
    prepare: bool
    parts: int  # with prepare; 0: as many as are sensible
    part: tuple[int, int] | None
    finish: bool
    save_blend: Path | None
    listed: Source | None = None  # a file to list; `sets` is empty then where there is no motion


def request_from(options: argparse.Namespace) -> Request:
    """The request of parsed options: what was given, else the preset's, else the default.

    Raises GenerateError for options that do not go together or are out of range.
    """
    values = {**DEFAULTS, **PRESETS[options.preset]}
    values.update({name: v for name in DEFAULTS if (v := getattr(options, name)) is not None})
    if values["cameras"] == "clips" and options.views is None:
        values["views"] = min(values["views"], CLIPS)
    check_together(options, values)
    names = _names(options)
    listed = names[0][1] if options.list else None
    if listed and options.motion is None:
        names = []
    sets = tuple(_settings(options, values, name, source) for name, source in names)
    return Request(
        sets, options.out or Path(), options.processes or 0, options.prepare, options.parts or 0, options.part,
        options.finish, options.save_blend, listed,
    )  # fmt: skip


def _names(options: argparse.Namespace) -> list[tuple[str, Source]]:
    given = [option for option in ("scene", "blend", "mesh") if getattr(options, option) is not None]
    if len(given) != 1:
        asked = " and ".join(given) or "none of them"
        hint = "" if given else "; --list alone names the scenes"
        raise GenerateError(f"give either SCENE, --blend or --mesh; {asked} given{hint}")
    if options.scene is not None:
        if options.scene != ALL and options.scene not in NAMES:
            raise GenerateError(f"scene {options.scene!r} is none of {', '.join(NAMES)}, {ALL}")
        return [(name, Source()) for name in (NAMES if options.scene == ALL else (options.scene,))]
    path: Path = options.blend or options.mesh
    if not path.is_file():
        raise GenerateError(f"--{given[0]} {path}: there is no such file")
    name = options.name or path.stem
    if not name.replace("-", "").replace("_", "").isalnum() or not name.isascii():
        raise GenerateError(
            f"--name {name!r}: letters, digits, - and _ only, since a folder is named after it"
        )
    return [(name, Source(given[0], str(path.resolve()), options.frame, options.blend_scene))]


def _settings(options: argparse.Namespace, values: dict[str, Any], name: str, source: Source) -> Settings:
    if source.kind != "builtin" and options.motion is None:
        raise GenerateError(f"--{source.kind} needs --motion FILE, a description of how it moves")
    motion = read_motion(motion_file(name, options.motion) if source.kind == "builtin" else options.motion)
    motion = motion.with_main(options.frequency, options.amplitude, options.amplitude_px)
    return Settings(
        scene=name,
        source=source,
        motion=motion,
        cameras=CameraSetup(
            kind=values["cameras"],
            views=values["views"],
            test_views=values["test_views"],
            n_timesteps=values["timesteps"],
            fps=values["fps"],
            seed=values["seed"],
            clock_offset_s=values["clock_offsets"],
        ),
        pictures=PictureFormat(values["images"], values["background"]),
        sensor=_sensor(options),
        effects=Effects(
            shake_px=values["shake"],
            exposure_drift=values["exposure_drift"],
            flicker=values["flicker"],
            flicker_hz=values["flicker_hz"],
            codec=values["codec"],
            crf=values["crf"],
            keep_video=options.keep_video,
            readout_ms=values["readout"],
            shutter_ms=values["shutter"],
        ),
        **{key: values[key] for key in _AS_THEY_ARE},
    )


_AS_THEY_ARE = ("size", "alphas", "samples", "seed", "noise", "truth", "points", "engine", "device")


def _sensor(options: argparse.Namespace) -> Sensor | None:
    sensor = Sensor.preset(options.sensor or "none")
    if options.jpeg is None:
        return sensor
    if sensor is None:
        raise GenerateError(f"--jpeg {options.jpeg} goes with --sensor")
    return replace(sensor, jpeg_quality=options.jpeg or None)


# What an animation, which is not rendered, has no use for.
_OF_PICTURES = (
    "samples", "points", "engine", "device", "images", "background", "sensor", "jpeg", "alphas", "truth",
    "shake", "exposure_drift", "flicker", "flicker_hz", "readout", "shutter", "noise", "codec", "crf", "keep_video",
)  # fmt: skip
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
