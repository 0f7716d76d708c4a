"""The command line's options: names, units, defaults and presets."""

import argparse
from pathlib import Path
from typing import Any, NoReturn

from .cameras import KINDS as CAMERA_KINDS
from .effects import CODECS
from .errors import GenerateError
from .pictures import BACKGROUNDS, IMAGES
from .pictures import PRESETS as SENSORS
from .scenes import NAMES
from .settings import DEVICES, ENGINES, NOISE, SECOND, TRUTH

ALL = "all"
ALPHAS = (5, 10, 20, 50, 100)
CLIPS = 7  # places that one camera films from, where --views does not say it
# What an option is where neither the command line nor the preset says it.
DEFAULTS: dict[str, Any] = {
    "size": 128, "timesteps": 30, "fps": 30.0, "cameras": "orbit", "views": 30, "test_views": 5,
    "clock_offsets": 0.0, "shake": 0.0, "exposure_drift": 0.0, "flicker": 0.0, "flicker_hz": 100.0,
    "codec": "none", "crf": 20, "readout": 0.0, "shutter": 0.0,
    "samples": 96, "seed": 0, "noise": "state", "points": 20000, "alphas": ALPHAS, "truth": "test",
    "engine": "cycles", "device": "cpu", "images": "png8", "background": "transparent",
}  # fmt: skip
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


_EXCLUSIVE = ("--amplitude", "--amplitude-px", "--prepare", "--part", "--finish")  # within their group


def _groups() -> dict[str, dict[str, dict[str, Any]]]:
    """Keywords of `add_argument` by flag, by title of the group."""
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
            **_numbers({"timesteps": "number of timesteps", "fps": "timesteps per second, Hz"}),
        },
        "cameras": {
            "--cameras": _choice("cameras", CAMERA_KINDS, (
                "orbit: NeRF-synthetic's spiral; rig: fixed, around the scene; sweep: one fixed, after a handheld "
                "round; handheld: one, all along; clips: one, from place after place; flat: one fixed; given: those "
                "of the .blend file"
            )),
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
