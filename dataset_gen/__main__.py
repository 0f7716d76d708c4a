"""Command line: `python -m dataset_gen SCENE --out DIR …`, the same arguments as `tg4mm generate`."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, NoReturn

from tg4mm.errors import Tg4mmError

from .run import RunFailed, generate
from .scenes import SCENES
from .settings import TRUTH, GenerateError, Settings

PRESETS: dict[str, dict[str, Any]] = {
    "smoke": {
        "size": 32,
        "timesteps": 6,
        "views": 4,
        "test_views": 2,
        "alphas": (5,),
        "samples": 4,
        "points": 500,
    },
    "demo": {},
    "paper": {"size": 512, "test_views": 10, "samples": 128, "points": 50000},
}


class _Parser(argparse.ArgumentParser):
    """An ArgumentParser whose errors are one line, as all bad input here."""

    def error(self, message: str) -> NoReturn:
        raise GenerateError(message)


def _alphas(text: str) -> tuple[float, ...]:
    try:
        return tuple(
            float(word) if float(word) != int(float(word)) else int(float(word))
            for word in text.split(",")
            if word
        )
    except (ValueError, OverflowError):
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of numbers such as 5,10,20") from None


def parser() -> argparse.ArgumentParser:
    """All options. Their defaults are those of `Settings`, unless a preset says otherwise."""
    default = Settings()
    p = _Parser(
        prog="python -m dataset_gen",
        description="Renders a vibrating scene from many cameras, with exact ground truth of the motion.",
        epilog="A run that was stopped goes on where it was when it is started again with the same options.",
    )
    p.add_argument("scene", metavar="SCENE", help=f"one of: {', '.join(sorted(SCENES))}")
    p.add_argument("--out", type=Path, required=True, metavar="DIR", help="parent folder of the dataset")
    p.add_argument("--preset", choices=sorted(PRESETS), default="demo",
                   help="smoke: 32 px, 4 views, 6 timesteps; demo: the defaults here; "
                        "paper: 512 px, 10 test views, 128 samples (default: demo)")  # fmt: skip
    for name, kind, text in (
        ("size", int, "edge of the square images, pixels"),
        ("timesteps", int, "number of timesteps"),
        ("fps", float, "timesteps per second, Hz"),
        ("frequency", float, "of the vibration, Hz; below half of --fps"),
        ("amplitude", float, "largest displacement, scene units"),
        ("views", int, "training cameras"),
        ("test-views", int, "test cameras, 10 in the published data"),
        ("samples", int, "light paths per pixel"),
        ("seed", int, "of the renderer and of the points"),
        ("points", int, "points in points3d.ply, 0 for none"),
    ):
        value = getattr(default, name.replace("-", "_"))
        p.add_argument(
            f"--{name}", type=kind, metavar="N" if kind is int else "X", help=f"{text} (default: {value:g})"
        )
    p.add_argument("--alphas", type=_alphas, metavar="A,A,…",
                   help="magnification factors of the ground truth; a displacement grows to (1 + A) times "
                        "its size (default: 5,10,20,50)")  # fmt: skip
    p.add_argument("--truth", choices=TRUTH,
                   help="splits with per-pixel depth, normal, position and displacement; 5 MB a view and "
                        "distinct state at 512 px, so not all by default (default: test)")  # fmt: skip
    p.add_argument(
        "--processes",
        type=int,
        default=0,
        metavar="N",
        help="render processes at once (default: one per core)",
    )
    return p


def settings_from(options: argparse.Namespace) -> Settings:
    """Settings of parsed options: what was given, else the preset's, else the default."""
    given = {
        f.name: getattr(options, f.name) for f in fields(Settings) if getattr(options, f.name) is not None
    }
    return Settings(**{**PRESETS[options.preset], **given})


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the generator. Returns 0 done, 2 bad input (one line says what), 1 failed, 130 stopped."""
    start = time.monotonic()
    try:
        options = parser().parse_args(argv)
        if options.processes < 0:
            raise GenerateError(f"--processes {options.processes} is negative")
        root = generate(settings_from(options), options.out, options.processes)
    except Tg4mmError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except RunFailed as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("stopped; the same command goes on from here", file=sys.stderr)
        return 130
    print(f"complete: {root}  ({time.monotonic() - start:.0f} s)", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
