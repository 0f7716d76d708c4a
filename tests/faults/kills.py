"""Commands that are killed, at random moments or after a rename, and given again: nothing is lost or half-written.

    python -m tests.faults.kills --kills 60 [--command train|render|…] [--renames 40] [--seed 0]

After each kill every file is as an undisturbed command leaves it, or it is a temporary one; a file that was whole
before stays. In the end the command is given once more, and leaves what an undisturbed one does, bit for bit, and
nothing besides: no checkpoint, no temporary file.
"""

import argparse
import contextlib
import os
import random
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

from safetensors import safe_open

import tg4mm.capture.sfm.reconstruct
import tg4mm.fit.space.train
import tg4mm.research.paper.motion
import tg4mm.research.paper.space
import tg4mm.show.measure
import tg4mm.show.render
from tests.helpers.synthetic import make_synthetic_dataset, moving_run
from tg4mm.cli import main as program
from tg4mm.core.files import is_temporary

OFTEN_S = 0.1  # between checkpoints, so that there are some in a training of seconds
_REPLACE = os.replace
TRAIN = "train F/set --out F/out --set space.max_gaussians=300 --set "
BENCH = " --set ".join(
    ("", "space.iterations=60", "space.max_gaussians=300", "motion.iterations=4", "motion.components=2")
)
PAPER = "channels=2 resolution=16 iterations=80 warm_up=40 motion_iterations=20".replace(" ", " --set paper.")
GENERATE = "--size 16 --samples 1 --timesteps 3 --views 3 --test-views 1 --alphas 5 --truth none --points 0"
STAGES = ("out/*.safetensors", "out/*.json")


@dataclass(frozen=True)
class Command:
    """`prepare(folder)` makes what is given to the command; of its words, F is the folder. It writes there, too."""

    prepare: Callable[[Path], object]
    words: str
    passing: tuple[str, ...] = ()  # patterns of files that are not what they will be while it works


def _dataset(folder):
    make_synthetic_dataset(
        folder / "set", n_views=3, n_timesteps=6, size=24, freqs=(5.0,), amplitude=0.03, alphas=(), n_test=0
    )


def _scored(folder):
    make_synthetic_dataset(
        folder / "sway_5Hz_0_03", n_views=5, n_timesteps=6, size=32, freqs=(5.0,), alphas=(5,), n_test=1
    )


def _run(folder):
    from tests.show.measure.filmed import modes, of_parts, run_of, sine

    run_of(folder, of_parts(ball=sine(5.0, [0.01, 0, 0])), modes({}, 8), n_timesteps=8, n_views=3)


def _video(folder):
    from tests.capture.sfm.videos import still, write_video

    write_video(folder / "a.mp4", still(12))


def _moving(folder):
    moving_run(folder, n_views=3, n_timesteps=8, size=24, freqs=(5.0,), amplitude=0.03, n_test=1, alphas=(5,))


def _long_video(folder):
    from tests.capture.sfm.videos import still, write_video

    write_video(folder / "a.mp4", still(30))


def _photographs(folder):
    from tests.capture.sfm.scenes import intrinsics, orbit, picture, save

    (folder / "in").mkdir()
    for i, viewmat in enumerate(orbit(8, turn=1.8)):
        shown = picture(viewmat, intrinsics(240, 180, 250.0), (240, 180), 0.0, False)
        save(folder / "in" / f"p_{i}.png", shown)


COMMANDS = {
    "train": Command(_dataset, f"{TRAIN}space.iterations=120 --set motion.iterations=3", STAGES),
    "train-paper-tuned": Command(_dataset, f"{TRAIN}paper.{PAPER} --preset paper-tuned", STAGES),
    "render": Command(_run, "render F/run --alpha 0 --split train --out F/out"),
    "measure": Command(_run, "measure F/run --out F/out --sensor all"),
    "sfm": Command(_video, "sfm F/a.mp4 --out F/out"),
    "sfm-photographs": Command(
        _photographs,
        "sfm F/in --out F/out",
        ("out/sfm/*.tmp*", "out/sfm/.*", "out/sfm/sparse/.*", "out/sfm/database.db*"),
    ),
    "look": Command(_long_video, "look F/a.mp4 --out F/out"),
    "process": Command(_long_video, "process F/a.mp4 --out F/out --quick", ("out/process.json", "out/run/*")),
    "evaluate": Command(_moving, "evaluate F/run --out F/out.json"),
    "export-usd": Command(_moving, "export F/run --format usd --out F/out.usdc"),
    "convert-colmap": Command(_dataset, "convert F/set --to colmap --out F/out"),
    "bench": Command(
        _scored,
        f"bench scenes F/sway_5Hz_0_03 --out F/out --same-time never --methods modal,linear-2d --alphas 5{BENCH}",
        ("out/.warm-up-*", "out/results*", "out/*.svg", "out/tables/*", "out/runs/*"),
    ),
    "generate": Command(lambda folder: None, f"generate mic --out F/out {GENERATE}", ("*/.parts/*",)),
}


def in_child(work, said, kill_after_s=None):
    """The wait status of a forked process that did the work. What it says goes to a file.

    kill_after_s: it is killed after so many seconds, with all the processes that it has started.
    """
    child = os.fork()
    if child == 0:
        status = 1
        os.setpgid(0, 0)
        with said.open("w") as file:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
            try:
                work()
                status = 0
            except BaseException:
                traceback.print_exc()
            finally:
                sys.stderr.flush()
                os._exit(status)
    with contextlib.suppress(OSError):  # the child may have done so, and be over
        os.setpgid(child, child)
    if kill_after_s is not None:
        end = time.monotonic() + kill_after_s
        while time.monotonic() < end:
            done, status = os.waitpid(child, os.WNOHANG)
            if done:
                return status
            time.sleep(0.002)
        os.killpg(child, signal.SIGKILL)
    return os.waitpid(child, 0)[1]


class Trial:
    """One command, what it leaves undisturbed, and folders in which it is killed."""

    def __init__(self, root, name):
        self.root, self.name, self.command = root, name, COMMANDS[name]
        self.said = root / "said.txt"
        (root / "given").mkdir()
        self._must(lambda: self.command.prepare(root / "given"))
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
        assert not {path for path in self.varying if path.endswith(".safetensors")}

    def _copy(self, name):
        shutil.copytree(self.root / "given", self.root / name)
        return self.root / name

    def _must(self, work):
        if in_child(work, self.said):
            said = self.said.read_text()[-2000:]
            raise AssertionError(f"{self.name}, killed by nobody, has failed: {said}")

    def give(self, folder, rename=0):
        """The command; killed right after its `rename`-th rename, unless that is 0."""
        for module in (tg4mm.fit.space.train, tg4mm.research.paper.space):
            module.CHECKPOINT_EVERY_S = OFTEN_S
        left = rename

        def replace(source, target):
            nonlocal left
            _REPLACE(source, target)
            left -= 1
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)

        os.replace = replace
        status = self._program(folder)
        assert status == 0, f"exit status {status}"

    def _program(self, folder):
        return program([word.replace("F/", f"{folder}/") for word in self.command.words.split()])

    def random_kills(self, kills, seed):
        """Kills at random moments, up to three in one folder. Returns how many struck before the end."""
        rng, struck, number = random.Random(seed), 0, 0
        while struck < kills:
            folder, number = self._copy(f"random_{number}"), number + 1
            before = contents(folder)
            for _ in range(rng.randint(1, 3)):
                moment = rng.uniform(0.0, self.seconds)
                struck += os.WIFSIGNALED(in_child(lambda f=folder: self.give(f), self.said, moment))
                before = self.check_whole(folder, before, f"killed after {moment:.3f} s")
            self.check_finished(folder, before)
        return struck

    def kills_after_renames(self, most, step):
        """A kill after the first rename, `step` renames later in another folder, and so on. Returns how many."""
        numbers = range(1, most + 1, step)
        for i, n in enumerate(numbers):
            folder = self._copy(f"rename_{n}")
            before = contents(folder)
            if not os.WIFSIGNALED(in_child(lambda f=folder, n=n: self.give(f, n), self.said)):
                return i
            self.check_finished(folder, self.check_whole(folder, before, f"killed after rename {n}"))
        return len(numbers)

    def check_finished(self, folder, before):
        """Let the command finish, and compare. Raises AssertionError."""
        self._must(lambda: self.give(folder))
        found = self.check_whole(folder, before, "in the end", passing=())
        if odd := sorted(found.keys() ^ self.expected.keys()):
            raise AssertionError(f"{self.name}, in the end: not the files of an undisturbed one: {odd[:5]}")
        shutil.rmtree(folder)

    def check_whole(self, folder, before, how, passing=None):
        """What is there now. Raises AssertionError for a file that is lost or not whole."""
        found = contents(folder)
        for path, data in found.items():
            if any(fnmatch(path, p) for p in (self.command.passing if passing is None else passing)):
                continue
            if path not in self.expected or (path not in self.varying and data != self.expected[path]):
                size = len(data)
                raise AssertionError(f"{self.name}, {how}: {path} of {size} bytes is not what it should be")
        if lost := sorted(path for path in before.keys() - found.keys() if path in self.expected):
            raise AssertionError(f"{self.name}, {how}: {lost[:5]} are gone")
        return found


def contents(folder):
    """Every file below but temporary ones and locks; of safetensors the tensors, whose header has no fixed order."""
    files = [f for f in folder.rglob("*") if f.is_file() and not f.name.endswith(".lock")]
    return {f.relative_to(folder).as_posix(): _content(f) for f in files if not is_temporary(f)}


def _content(file):
    if file.suffix != ".safetensors":
        return file.read_bytes()
    with safe_open(file, framework="numpy") as held:
        return b"".join(name.encode() + held.get_tensor(name).tobytes() for name in sorted(held.keys()))


def main():
    """Prints what was done; ends with an AssertionError where something was lost."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--kills", type=int, default=10, help="at random moments (10)")
    parser.add_argument("--renames", type=int, default=0, help="kills after a rename, at most (0)")
    parser.add_argument("--step", type=int, default=1, help="renames from one kill to the next folder's (1)")
    parser.add_argument("--command", choices=list(COMMANDS), help="one of them (default: all)")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    for name in [args.command] if args.command else COMMANDS:
        with tempfile.TemporaryDirectory(prefix="tg4mm-kills-") as folder:
            trial = Trial(Path(folder), name)
            renames = trial.kills_after_renames(args.renames, args.step)
            struck = trial.random_kills(args.kills, args.seed)
            kinds = f"{renames} kills after a rename, {struck} at random moments, seed {args.seed}"
            print(f"{name}, {trial.seconds:.1f} s: {kinds}: nothing lost", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
