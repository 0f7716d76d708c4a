"""What the command line asks for: from parsed options to settings."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from .arguments import ALL, ALPHAS, CLIPS, DEFAULTS, PRESETS, parser
from .cameras import CameraSetup
from .combinations import check_together
from .effects import Effects
from .errors import GenerateError
from .pictures import PictureFormat
from .scenes import NAMES
from .sensor import Sensor
from .settings import Settings, Source, motion_file
from .vibration import read_motion

__all__ = ["ALL", "ALPHAS", "DEFAULTS", "PRESETS", "Request", "parser", "request_from"]


@dataclass(frozen=True)
class Request:
    """What the command line asks for."""

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
    """(name, source) of every set."""
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
    motion = read_motion(options.motion or motion_file(name))
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
        ),
        **{key: values[key] for key in _AS_THEY_ARE},
    )


_AS_THEY_ARE = ("size", "alphas", "samples", "seed", "truth", "points", "engine", "device")


def _sensor(options: argparse.Namespace) -> Sensor | None:
    sensor = Sensor.preset(options.sensor or "none")
    if options.jpeg is None:
        return sensor
    if sensor is None:
        raise GenerateError(f"--jpeg {options.jpeg} goes with --sensor")
    return replace(sensor, jpeg_quality=options.jpeg or None)
