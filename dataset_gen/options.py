"""The command line's options, and the settings they make."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn

from .cameras import KINDS as CAMERA_KINDS
from .cameras import CameraSetup
from .errors import GenerateError
from .pictures import BACKGROUNDS, IMAGES, PictureFormat
from .scenes import NAMES
from .sensor import PRESETS as SENSORS
from .sensor import Sensor
from .settings import DEVICES, ENGINES, TRUTH, Settings, Source, motion_file
from .vibration import read_motion

ALL = "all"
ALPHAS = (5, 10, 20, 50, 100)
# What an option is where neither the command line nor the preset says it.
DEFAULTS: dict[str, Any] = {
    "size": 128,
    "timesteps": 30,
    "fps": 30.0,
    "cameras": "orbit",
    "views": 30,
    "test_views": 5,
    "samples": 96,
    "seed": 0,
    "points": 20000,
    "alphas": ALPHAS,
    "truth": "test",
    "engine": "cycles",
    "device": "cpu",
    "images": "png8",
    "background": "transparent",
}
PRESETS: dict[str, dict[str, Any]] = {
    "smoke": {
        "size": 96,
        "timesteps": 6,
        "views": 4,
        "test_views": 2,
        "alphas": (5, 50),
        "samples": 8,
        "points": 2000,
    },
    "demo": {},
    "paper": {"size": 512, "test_views": 10, "samples": 128, "points": 50000},
}
_HELP = {
    "size": "edge of the square images, pixels",
    "timesteps": "number of timesteps",
    "fps": "timesteps per second, Hz",
    "views": "training cameras of an orbit or a rig; pictures of a sweep",
    "test_views": "test cameras, 10 in the published data",
    "samples": "light paths per pixel",
    "seed": "of the renderer, the sensor, the points and shaky hands",
    "points": "points in points3d.ply, 0 for none",
}


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


class _Parser(argparse.ArgumentParser):
    """An ArgumentParser whose errors are one line, as all bad input here."""

    def error(self, message: str) -> NoReturn:
        raise GenerateError(message)


def parser() -> argparse.ArgumentParser:
    """All options, with units and defaults."""
    p = _Parser(
        prog="tg4mm generate",
        description="Renders a vibrating scene from many cameras, with exact ground truth of the motion.",
        epilog="A run that was stopped goes on where it was when it is started again with the same options.",
        allow_abbrev=False,
    )
    p.add_argument(
        "scene", metavar="SCENE", nargs="?", help=f"one of: {', '.join(NAMES)}; or all of them: {ALL}"
    )
    p.add_argument("--out", type=Path, metavar="DIR", help="parent folder of the dataset")
    p.add_argument("--preset", choices=sorted(PRESETS), default="demo", help=_presets())
    _source_options(p.add_argument_group("your own scene, instead of SCENE"))
    _motion_options(p.add_argument_group("motion"))
    _camera_options(p.add_argument_group("cameras"))
    _picture_options(p.add_argument_group("pictures and truth"))
    _work_options(p.add_argument_group("the work"))
    return p


def _presets() -> str:
    smoke, paper = PRESETS["smoke"], PRESETS["paper"]
    return (
        f"smoke: {smoke['size']} px, {smoke['views']} views, {smoke['timesteps']} timesteps; demo: the defaults "
        f"here; paper: {paper['size']} px, {paper['test_views']} test views, {paper['samples']} samples "
        "(default: demo)"
    )


def _number(group: argparse._ArgumentGroup, name: str) -> None:
    kind = type(DEFAULTS[name])
    group.add_argument(
        f"--{name.replace('_', '-')}",
        type=kind,
        metavar="N" if kind is int else "X",
        help=f"{_HELP[name]} (default: {DEFAULTS[name]:g})",
    )


def _choice(group: argparse._ArgumentGroup, name: str, choices: tuple[str, ...], text: str) -> None:
    group.add_argument(f"--{name}", choices=choices, help=f"{text} (default: {DEFAULTS[name]})")


def _source_options(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--blend", type=Path, metavar="FILE", help="a .blend file; its scene at its current frame"
    )
    group.add_argument(
        "--mesh", type=Path, metavar="FILE", help="a glTF, OBJ, PLY, STL, USD or FBX file, brought to size"
    )
    group.add_argument("--frame", type=int, metavar="N", help="with --blend: the frame (default: the file's)")
    group.add_argument(
        "--scene", dest="blend_scene", metavar="NAME", help="with --blend: the scene (default: the file's)"
    )
    group.add_argument("--name", metavar="NAME", help="first part of the folder's name (default: the file's)")


def _motion_options(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--motion", type=Path, metavar="FILE", help="YAML or JSON description (default: the scene's own)"
    )
    group.add_argument(
        "--frequency",
        type=float,
        metavar="X",
        help="of the first mode and of those that share its frequency, Hz; below half of --fps",
    )
    amount = group.add_mutually_exclusive_group()
    amount.add_argument(
        "--amplitude",
        type=float,
        metavar="X",
        help="largest displacement of the first mode, scene units; modes of its frequency go along in proportion",
    )
    amount.add_argument(
        "--amplitude-px", type=float, metavar="X", help="the same in pixels of the first training camera"
    )
    _number(group, "timesteps")
    _number(group, "fps")


def _camera_options(group: argparse._ArgumentGroup) -> None:
    text = (
        "orbit: NeRF-synthetic's spiral; rig: fixed, around the scene; sweep: one fixed, after a handheld round; "
        "handheld: one, all along; given: those of the .blend file"
    )
    _choice(group, "cameras", CAMERA_KINDS, text)
    for name in ("views", "test_views"):
        _number(group, name)


def _picture_options(group: argparse._ArgumentGroup) -> None:
    for name in ("size", "samples", "seed", "points"):
        _number(group, name)
    _choice(group, "engine", ENGINES, "Blender's renderer")
    _choice(group, "device", DEVICES, "where Cycles runs")
    _choice(group, "images", IMAGES, "8 or 16 bits, or linear EXR")
    _choice(group, "background", BACKGROUNDS, "straight alpha, or white and opaque")
    group.add_argument(
        "--sensor", choices=("none", *SENSORS), help="noise of a camera, new in every frame (default: none)"
    )
    group.add_argument(
        "--jpeg",
        type=int,
        metavar="Q",
        help="with --sensor: JPEG of this quality, 1 … 100, in between; 0 for none (default: the sensor's own)",
    )
    group.add_argument("--alphas", type=_alphas, metavar="A,A,…",
                       help="magnification factors of the ground truth; a displacement grows to (1 + A) times "
                            f"its size (default: {','.join(map(str, ALPHAS))})")  # fmt: skip
    _choice(group, "truth", TRUTH, "splits with per-pixel depth, normal, position and displacement; 5 MB a view and "
            "distinct state at 512 px, so not all by default")  # fmt: skip


def _work_options(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--processes",
        type=int,
        default=0,
        metavar="N",
        help="render processes at once (default: one per core)",
    )
    group.add_argument(
        "--save-blend", type=Path, metavar="FILE", help="only save the animated scene as a .blend that plays"
    )
    phase = group.add_mutually_exclusive_group()
    phase.add_argument("--prepare", action="store_true", help="only what comes before rendering, for a farm")
    phase.add_argument("--part", type=_part, metavar="I/N", help="only render part I of N")
    phase.add_argument("--finish", action="store_true", help="only what comes after all parts")
    group.add_argument(
        "--parts", type=int, default=0, metavar="N", help="with --prepare: how many parts (default: by size)"
    )


def _alphas(text: str) -> tuple[float, ...]:
    try:
        return tuple(
            float(word) if float(word) != int(float(word)) else int(float(word))
            for word in text.split(",")
            if word
        )
    except (ValueError, OverflowError):
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of numbers such as 5,10,20") from None


def _part(text: str) -> tuple[int, int]:
    try:
        number, parts = (int(word) for word in text.split("/"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a part such as 3/10") from None
    return number, parts


def request_from(options: argparse.Namespace) -> Request:
    """The request of parsed options: what was given, else the preset's, else the default.

    Raises GenerateError for options that do not go together or are out of range.
    """
    if options.processes < 0:
        raise GenerateError(f"--processes {options.processes} is negative")
    if options.parts < 0 or (options.parts and not options.prepare):
        raise GenerateError(f"--parts {options.parts} goes with --prepare and is at least 1")
    values = {**DEFAULTS, **PRESETS[options.preset]}
    values.update({name: v for name in DEFAULTS if (v := getattr(options, name)) is not None})
    if options.out is None and options.save_blend is None:
        raise GenerateError("--out DIR is needed: the parent folder of the dataset")
    names = _names(options)
    sets = tuple(_settings(options, values, name, source) for name, source in names)
    if options.save_blend and len(sets) != 1:
        raise GenerateError(f"--save-blend {options.save_blend} takes one scene, not {ALL}")
    return Request(
        sets, options.out or Path(), options.processes, options.prepare, options.parts, options.part, options.finish,
        options.save_blend,
    )  # fmt: skip


def _names(options: argparse.Namespace) -> list[tuple[str, Source]]:
    """(name, source) of every set."""
    given = [option for option in ("scene", "blend", "mesh") if getattr(options, option) is not None]
    if len(given) != 1:
        asked = " and ".join(given) or "none of them"
        raise GenerateError(f"give either SCENE, --blend or --mesh; {asked} given")
    if options.blend is None and (options.frame is not None or options.blend_scene is not None):
        raise GenerateError("--frame and --scene go with --blend")
    if options.scene is not None:
        if options.name is not None:
            raise GenerateError(f"--name {options.name} goes with --blend and --mesh")
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
        ),
        pictures=PictureFormat(values["images"], values["background"]),
        sensor=_sensor(options),
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
