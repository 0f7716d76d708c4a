"""Conversion of parsed command-line options to settings."""

import argparse
import math
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NoReturn

from .cameras import KINDS as CAMERA_KINDS
from .cameras import CameraSetup
from .effects import CODECS, Effects
from .errors import GenerateError
from .pictures import BACKGROUNDS, IMAGES, ImageSensor, PictureFormat
from .pictures import PRESETS as SENSORS
from .scenes import NAMES
from .settings import DEVICES, ENGINES, NOISE, SECOND, TRUTH, Settings, Source, motion_file
from .vibration import read_motion

ALL = "all"
ALPHAS = (5, 10, 20, 50, 100)
CLIPS = 7  # places that one camera films from, where --views does not say it
# Options and what they set: a part of the settings, and its field where that has another name.
_PARTS: dict[type[Any], dict[str, str]] = {
    CameraSetup: {
        "cameras": "kind", "views": "", "test_views": "", "timesteps": "n_timesteps", "fps": "",
        "clock_offsets": "clock_offset_s",
    },
    Effects: {
        "shake": "shake_px", "exposure_drift": "", "flicker": "", "flicker_hz": "", "codec": "", "crf": "",
        "readout": "readout_ms", "shutter": "shutter_ms",
    },
    PictureFormat: {"images": "", "background": ""},
    Settings: dict.fromkeys(
        ("size", "samples", "seed", "noise", "points", "alphas", "truth", "engine", "device"), ""
    ),
}  # fmt: skip
# What an option is where neither the command line nor the preset says it.
DEFAULTS: dict[str, Any] = {
    option: next(f.default for f in fields(part) if f.name == (name or option))
    for part, names in _PARTS.items()
    for option, name in names.items()
}
PRESETS: dict[str, dict[str, Any]] = {
    "smoke": {
        "size": 96, "timesteps": 6, "views": 4, "test_views": 2, "alphas": (5, 50), "samples": 8, "points": 2000,
    },
    "demo": {},
    "paper": {"size": 512, "test_views": 10, "samples": 128, "points": 50000},
}  # fmt: skip
_EXCLUSIVE = ("--amplitude", "--amplitude-px", "--prepare", "--part", "--finish")  # within their group
_WHOLE = 1e-6  # periods

# What an animation, which is not rendered, has no use for.
_OF_PICTURES = (
    "samples", "points", "engine", "device", "images", "background", "sensor", "jpeg", "alphas", "truth",
    "shake", "exposure_drift", "flicker", "flicker_hz", "readout", "shutter", "noise", "codec", "crf", "keep_video",
)  # fmt: skip
_OF_WORK = ("out", "prepare", "part", "finish", "parts", "processes")


class _Parser(argparse.ArgumentParser):
    """An ArgumentParser whose errors are one line, as all bad input here."""

    def error(self, message: str) -> NoReturn:
        raise GenerateError(message)


def parser() -> argparse.ArgumentParser:
    """All options, with units and defaults."""
    p = _Parser(
        prog="tg4mm generate",
        description="Renders a vibrating scene from many cameras, with exact ground truth of the motion.",
        epilog="A command that was stopped continues when it is given again with the same options.",
        allow_abbrev=False,
    )
    scenes = f"one of: {', '.join(NAMES)}; or {ALL} for all of them"
    p.add_argument("scene", metavar="SCENE", nargs="?", help=scenes)
    p.add_argument("--out", type=Path, metavar="DIR", help="parent folder of the dataset")
    p.add_argument("--preset", choices=sorted(PRESETS), default="demo", help=_presets())
    for title, options in _groups().items():
        group, exclusive = p.add_argument_group(title), None
        for flag, about in options.items():
            if flag in _EXCLUSIVE:
                exclusive = exclusive or group.add_mutually_exclusive_group()
            (exclusive if exclusive and flag in _EXCLUSIVE else group).add_argument(flag, **about)
    return p


def _groups() -> dict[str, dict[str, dict[str, Any]]]:
    """Keywords of `add_argument` by flag, by title of the group."""
    cameras = "; ".join(f"{name}: {kind.about}" for name, kind in CAMERA_KINDS.items())
    return {
        "your own scene, instead of SCENE": {
            "--blend": _file("a .blend file; its scene at its current frame"),
            "--mesh": _file("a glTF, OBJ, PLY, STL, USD or FBX file, scaled to the size of the built-in scenes"),
            "--frame": {"type": int, "metavar": "N", "help": "with --blend: the frame (default: the file's)"},
            "--scene": {
                "dest": "blend_scene", "metavar": "NAME", "help": "with --blend: the scene (default: the file's)"
            },
            "--list": _flag(
                "only list parts, boxes, vertex groups and scale, and with --motion the amplitudes; alone, the "
                "built-in scenes; writes nothing"
            ),
            "--name": {"metavar": "NAME", "help": "first part of the folder's name (default: the file's)"},
        },
        "motion": {
            "--motion": _file(
                f"YAML or JSON description (default: the scene's own); {SECOND}: a built-in scene's other one"
            ),
            "--frequency": _real(
                "frequency of the first mode and of those that share it, Hz; below half of --fps"
            ),
            "--amplitude": _real(
                "largest displacement of the first mode, scene units; modes of its frequency are scaled with it"
            ),
            "--amplitude-px": _real("the same in pixels of the first training camera"),
            **_numbers({
                "timesteps": "number of timesteps; more by default where whole periods take more",
                "fps": "timesteps per second, Hz",
            }),
        },
        "cameras": {
            "--cameras": _choice("cameras", tuple(CAMERA_KINDS), cameras),
            **_numbers({
                "views": f"number of training cameras (orbit, rig), photographs (sweep) or clips ({CLIPS} by default)",
                "test_views": "number of test cameras; the published data have 10, flat has one",
                "clock_offsets": "cameras start up to this long before or after the first one, seconds",
            }),
        },
        "pictures and truth": {
            **_numbers({
                "size": "edge of the square images, pixels", "samples": "light paths per pixel",
                "seed": "seed of the renderer, the sensor noise, the points and the shake",
                "points": "points in points3d.ply, 0 for none",
            }),
            "--noise": _choice("noise", NOISE, (
                "pictures of one state share one render and its noise, or each is a render with noise of its own"
            )),
            "--engine": _choice("engine", ENGINES, "Blender's renderer"),
            "--device": _choice("device", DEVICES, "where Cycles runs"),
            "--images": _choice("images", IMAGES, "8 or 16 bits, or linear EXR"),
            "--background": _choice("background", BACKGROUNDS, "straight alpha, or white and opaque"),
            "--sensor": {
                "choices": ("none", *SENSORS), "help": "noise of a camera, new in every frame (default: none)"
            },
            "--jpeg": {"type": int, "metavar": "Q", "help": (
                "with --sensor: JPEG of this quality, 1 … 100, in between; 0 for none (default: the sensor's own)"
            )},
            "--alphas": {"type": _alphas, "metavar": "A,A,…", "help": (
                "magnification factors of the ground truth; a displacement grows to (1 + A) times its size (default: "
                f"{','.join(map(str, ALPHAS))})"
            )},
            "--truth": _choice("truth", TRUTH, (
                "splits with per-pixel depth, normal, position and displacement; 5 MB a view and distinct state at "
                "512 px, so not all by default"
            )),
        },
        "effects of real cameras, on training pictures, all off by default": {
            **_numbers({
                "shake": "every camera shakes (rotates at 1 … 10 Hz): rms shift of the picture, pixels",
                "exposure_drift": "slow change of brightness, percent peak to peak; of colour, a third of that",
                "flicker": "flicker of the light, percent peak to peak",
                "flicker_hz": "with --flicker: its frequency, Hz",
                "readout": "rolling shutter of fixed cameras: milliseconds from the first row to the last",
                "shutter": "motion blur of fixed cameras: exposure of each picture, milliseconds",
            }),
            "--codec": _choice("codec", CODECS, "each camera's pictures go through a video"),
            **_numbers({"crf": "with --codec: rate factor, 0 … 51; larger is worse"}),
            "--keep-video": _flag("with --codec: keep the videos, in video/"),
        },
        "the work": {
            "--processes": {
                "type": int, "metavar": "N", "help": "number of render processes at once (default: one per core)"
            },
            "--save-blend": _file("only save the animated scene as a .blend file"),
            "--prepare": _flag("only prepare rendering in parts, on many machines"),
            "--part": {"type": _part, "metavar": "I/N", "help": "only render part I of N"},
            "--finish": _flag("only finish the dataset, after all parts"),
            "--parts": {"type": int, "metavar": "N", "help": "with --prepare: how many parts (default: by size)"},
        },
    }  # fmt: skip


def _presets() -> str:
    smoke, paper = PRESETS["smoke"], PRESETS["paper"]
    return (
        f"smoke: {smoke['size']} px, {smoke['views']} views, {smoke['timesteps']} timesteps; demo: the defaults "
        f"here; paper: {paper['size']} px, {paper['test_views']} test views, {paper['samples']} samples "
        "(default: demo)"
    )


def _file(text: str) -> dict[str, Any]:
    return {"type": Path, "metavar": "FILE", "help": text}


def _flag(text: str) -> dict[str, Any]:
    return {"action": "store_true", "help": text}


def _real(text: str) -> dict[str, Any]:
    return {"type": float, "metavar": "X", "help": text}


def _numbers(texts: dict[str, str]) -> dict[str, dict[str, Any]]:
    made = {}
    for name, text in texts.items():
        kind = type(DEFAULTS[name])
        about = {
            "type": kind,
            "metavar": "N" if kind is int else "X",
            "help": f"{text} (default: {DEFAULTS[name]:g})",
        }
        made[f"--{name.replace('_', '-')}"] = about
    return made


def _choice(name: str, choices: tuple[str, ...], text: str) -> dict[str, Any]:
    return {"choices": choices, "help": f"{text} (default: {DEFAULTS[name]})"}


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
            raise GenerateError(f"scene {options.scene!r} is not one of {', '.join(NAMES)}, {ALL}")
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
    hz, fps = motion.main.law.frequency_hz, values["fps"]
    if options.timesteps is None and fps > 0:  # else refused below
        values = {**values, "timesteps": whole_periods(values["timesteps"], hz, fps)}
    settings = Settings(
        scene=name,
        source=source,
        motion=motion,
        cameras=CameraSetup(**_of(CameraSetup, values), seed=values["seed"]),
        pictures=PictureFormat(**_of(PictureFormat, values)),
        sensor=_sensor(options),
        effects=Effects(**_of(Effects, values), keep_video=options.keep_video),
        **_of(Settings, values),
    )
    if values["timesteps"] > 1 and 0 < values["timesteps"] * hz < (1 - _WHOLE) * fps:
        print(
            f"{name}: {values['timesteps']} timesteps hold {values['timesteps'] * hz / fps:.2g} periods of {hz:g} Hz, "
            f"so that the mean of the pictures is not the scene at rest; --timesteps {math.ceil(fps / hz)} hold one",
            file=sys.stderr,
        )
    return settings


def _of(part: type[Any], values: dict[str, Any]) -> dict[str, Any]:
    """The values of a part's fields."""
    return {name or option: values[option] for option, name in _PARTS[part].items()}


def whole_periods(least: int, hz: float, fps: float) -> int:
    """Return the number of timesteps, `least` or more, that hold whole periods of a frequency.

    Where more than twice as many would be needed: `least`, but one period, unless that is ten times as many.
    """
    for n in range(least, 2 * least + 1):
        periods = n * hz / fps
        if round(periods) and abs(periods - round(periods)) < _WHOLE:
            return n
    return max(least, math.ceil(fps / hz)) if fps / hz <= 10 * least else least


def _sensor(options: argparse.Namespace) -> ImageSensor | None:
    sensor = ImageSensor.preset(options.sensor or "none")
    if options.jpeg is None:
        return sensor
    if sensor is None:
        raise GenerateError(f"--jpeg {options.jpeg} needs --sensor")
    return replace(sensor, jpeg_quality=options.jpeg or None)


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
        yield f"--list needs --blend or --mesh, not the scene {options.scene}"
    for name in ("save_blend", *_OF_WORK, *_OF_PICTURES) if options.list else ():
        if getattr(options, name) not in (None, False):
            yield f"{_given(options, name)}: --list only reads the file, it writes nothing"


def _work(options: argparse.Namespace) -> Iterator[str]:
    if options.processes is not None and options.processes < 0:
        yield f"--processes {options.processes} is negative"
    if options.parts is not None and (options.parts < 1 or not options.prepare):
        yield f"--parts {options.parts} needs --prepare and is at least 1"
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
                yield f"{option} {value} needs --blend"
    if options.scene is not None and options.name is not None:
        yield f"--name {options.name} needs --blend or --mesh"


def _cameras(options: argparse.Namespace, values: Mapping[str, Any]) -> Iterator[str]:
    kind = values["cameras"]
    if options.views is not None and CAMERA_KINDS[kind].single:
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
        yield f"--jpeg {options.jpeg} needs --sensor"
    if options.flicker_hz is not None and not values["flicker"]:
        yield f"--flicker-hz {options.flicker_hz:g} needs --flicker"
    if values["codec"] == "none":
        for name in ("crf", "keep_video"):
            if getattr(options, name) not in (None, False):
                yield f"{_given(options, name)} needs --codec"


def _given(options: argparse.Namespace, name: str) -> str:
    """The option as it was given: "--part 1/2"."""
    value = getattr(options, name)
    if isinstance(value, tuple):
        value = ("/" if name == "part" else ",").join(f"{v:g}" for v in value)
    option = f"--{name.replace('_', '-')}"
    return option if value is True else f"{option} {value}"
