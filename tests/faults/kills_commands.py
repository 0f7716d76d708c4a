"""Commands that are killed at random moments and given again: nothing that was there is lost, nothing is half-written.

    python -m tests.faults.kills_commands --kills 20 [--command render|measure|sfm|generate] [--seed 0]

After each kill every file is as an undisturbed command leaves it, or it is a temporary one; a file that was whole
before stays. In the end the command is given once more, and leaves what an undisturbed one does.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

import tg4mm.capture.sfm.reconstruct
import tg4mm.show.measure
import tg4mm.show.render  # noqa: F401, so that no process after a fork has to
from tests.faults.kills import in_child
from tg4mm.cli import main as program
from tg4mm.core.temporary import is_temporary


@dataclass(frozen=True)
class Command:
    """`prepare(folder)` makes what is given to the command, and `words(folder)` are its words; it writes there, too."""

    prepare: Callable[[Path], object]
    words: Callable[[Path], list[str]]
    passing: tuple[str, ...] = ()  # patterns of files that are there only while it works


def _run(folder: Path) -> None:
    from tests.show.measure.filmed import modes, of_parts, run_of, sine

    run_of(folder, of_parts(ball=sine(5.0, [0.01, 0, 0])), modes({}, 8), n_timesteps=8, n_views=3)


def _video(folder: Path) -> None:
    from tests.capture.sfm.videos import still, write_video

    write_video(folder / "a.mp4", still(12))


def _photographs(folder: Path) -> None:
    from tests.capture.sfm.scenes import intrinsics, orbit, picture, save

    (folder / "in").mkdir()
    for i, viewmat in enumerate(orbit(8, turn=1.8)):
        save(
            folder / "in" / f"p_{i}.png",
            picture(viewmat, intrinsics(240, 180, 250.0), (240, 180), 0.0, False),
        )


RENDER = "--alpha 0 --split train"
GENERATE = "--size 16 --samples 1 --timesteps 3 --views 3 --test-views 1 --alphas 5 --truth none --points 0"
COMMANDS = {
    "render": Command(
        _run, lambda f: ["render", str(f / "run"), *RENDER.split(), "--out", str(f / "out")]
    ),
    "measure": Command(_run, lambda f: ["measure", str(f / "run"), "--out", str(f / "out"), "--sensor", "all"]),
    "sfm": Command(_video, lambda f: ["sfm", str(f / "a.mp4"), "--out", str(f / "out")]),
    "sfm-photographs": Command(
        _photographs, lambda f: ["sfm", str(f / "in"), "--out", str(f / "out")],
        ("out/sfm/*.tmp*", "out/sfm/.*", "out/sfm/sparse/.*", "out/sfm/database.db*"),
    ),
    "generate": Command(
        lambda f: None, lambda f: ["generate", "mic", "--out", str(f / "out"), *GENERATE.split()], ("*/.parts/*",)
    ),
}  # fmt: skip


class CommandTrial:
    """One command, what it leaves undisturbed, and folders in which it is killed."""

    def __init__(self, root: Path, name: str) -> None:
        self.root, self.name, self.command = root, name, COMMANDS[name]
        self.said = root / "said.txt"
        self._must(lambda: self.command.prepare(self._new("given")))
        self._must(lambda: self.give(self._copy("compiled")))  # so that the time below is the command's
        one, other = self._copy("one"), self._copy("other")
        began = time.monotonic()
        self._must(lambda: self.give(one))
        self.seconds = time.monotonic() - began
        self._must(lambda: self.give(other))
        self.expected, again = contents(one), contents(other)
        assert self.expected.keys() == again.keys(), "two undisturbed commands leave different files"
        # Dates, seconds, and the folder's own name.
        self.varying = {path for path, data in self.expected.items() if again[path] != data}

    def _new(self, name: str) -> Path:
        (self.root / name).mkdir()
        return self.root / name

    def _copy(self, name: str) -> Path:
        shutil.copytree(self.root / "given", self.root / name)
        return self.root / name

    def _must(self, work: Callable[[], object]) -> None:
        if in_child(work, self.said):
            raise AssertionError(
                f"{self.name}, killed by nobody, has failed: {self.said.read_text()[-2000:]}"
            )

    def give(self, folder: Path) -> None:
        status = program(self.command.words(folder))
        assert status == 0, f"exit status {status}"

    def random_kills(self, kills: int, seed: int) -> int:
        """Kills at random moments, up to three in one folder. Returns how many struck before the end."""
        rng, struck, number = random.Random(seed), 0, 0
        while struck < kills:
            folder, number = self._copy(f"random_{number}"), number + 1
            before = contents(folder)
            for _ in range(rng.randint(1, 3)):
                moment = rng.uniform(0.0, self.seconds)
                struck += os.WIFSIGNALED(in_child(lambda f=folder: self.give(f), self.said, moment))  # type: ignore[misc]
                before = self.check_whole(folder, before, f"killed after {moment:.3f} s")
            self._must(lambda f=folder: self.give(f))  # type: ignore[misc]
            self.check_whole(folder, before, "in the end")
            if contents(folder).keys() != self.expected.keys():
                odd = sorted(contents(folder).keys() ^ self.expected.keys())
                raise AssertionError(
                    f"{self.name}, in the end: not the files of an undisturbed one: {odd[:5]}"
                )
            shutil.rmtree(folder)
        return struck

    def check_whole(self, folder: Path, before: dict[str, bytes], how: str) -> dict[str, bytes]:
        """What is there now. Raises AssertionError for a file that is lost or not whole."""
        found = contents(folder)
        for path, data in found.items():
            if any(fnmatch(path, pattern) for pattern in self.command.passing):
                continue
            if path not in self.expected or (path not in self.varying and data != self.expected[path]):
                raise AssertionError(
                    f"{self.name}, {how}: {path} of {len(data)} bytes is not what it should be"
                )
        if lost := sorted(path for path in before.keys() - found.keys() if path in self.expected):
            raise AssertionError(f"{self.name}, {how}: {lost[:5]} are gone")
        return found


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below but temporary ones and locks."""
    files = [
        f for f in folder.rglob("*") if f.is_file() and not is_temporary(f) and not f.name.endswith(".lock")
    ]
    return {f.relative_to(folder).as_posix(): f.read_bytes() for f in files}


def main() -> int:
    """Prints what was done; ends with an AssertionError where something was lost."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=10, help="at random moments (10)")
    parser.add_argument("--command", choices=list(COMMANDS), help="one of them (default: all)")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    for name in [args.command] if args.command else COMMANDS:
        with tempfile.TemporaryDirectory(prefix="tg4mm-kills-") as folder:
            trial = CommandTrial(Path(folder), name)
            struck = trial.random_kills(args.kills, args.seed)
            print(
                f"{name}, {trial.seconds:.1f} s: {struck} kills, seed {args.seed}: nothing lost", flush=True
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
