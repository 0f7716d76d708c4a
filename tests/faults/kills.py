"""Training that is killed, at random moments and after every rename, and started again: nothing is lost or changed.

    python -m tests.faults.kills --kills 60 [--renames] [--preset modal|paper-tuned] [--seed 0]

The same tiny training goes on in one run folder after each kill. In the end its files must hold what an undisturbed
training's hold, bit for bit, and nothing besides: no checkpoint, no temporary file, no lock.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path

import tg4mm.fit.space.train
import tg4mm.research.paper.motion
import tg4mm.research.paper.space
from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.run import Run
from tg4mm.run.tensor_file import model_hash
from tg4mm.run.train import train

OFTEN_S = 0.1  # between checkpoints, so that there are some in a training of seconds
SETTINGS: dict[str, dict[str, str]] = {
    "modal": {"space.iterations": "120", "space.max_gaussians": "300", "motion.iterations": "3"},
    "paper-tuned": {
        "paper.channels": "2", "paper.resolution": "16", "paper.iterations": "80", "paper.warm_up": "40",
        "paper.motion_iterations": "20", "space.max_gaussians": "200",
    },
}  # fmt: skip
_REPLACE = os.replace


def in_child(work: Callable[[], object], said: Path, kill_after_s: float | None = None) -> int:
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
    """One dataset and preset, an undisturbed run of them, and runs that are killed."""

    def __init__(self, root: Path, preset: str) -> None:
        self.root, self.preset, self.data = root, preset, root / "sway_5Hz_0_03"
        self.said = root / "said.txt"
        self._must(lambda: make_synthetic_dataset(
            self.data, n_views=3, n_timesteps=6, size=24, freqs=(5.0,), amplitude=0.03, alphas=(), n_test=0
        ))  # fmt: skip
        self._must(lambda: self.train("compiled"))  # so that the time below is the training's
        began = time.monotonic()
        self._must(lambda: self.train("undisturbed"))
        self.seconds = time.monotonic() - began
        self.expected = self.content("undisturbed")

    def _must(self, work: Callable[[], object]) -> None:
        if in_child(work, self.said):
            raise AssertionError(f"a process that nobody killed has failed: {self.said.read_text()[-2000:]}")

    def train(self, name: str) -> None:
        for module in (tg4mm.fit.space.train, tg4mm.research.paper.space, tg4mm.research.paper.motion):
            module.CHECKPOINT_EVERY_S = OFTEN_S  # type: ignore[attr-defined]
        train(self.data, self.root / name, self.preset, settings=SETTINGS[self.preset])

    def train_until_rename(self, name: str, n: int) -> None:
        """Killed right after the n-th rename from now."""
        left = n

        def replace(source, target) -> None:
            nonlocal left
            _REPLACE(source, target)
            left -= 1
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)

        os.replace = replace  # type: ignore[assignment]
        self.train(name)

    def content(self, name: str) -> tuple[list[str], str, bytes]:
        """Names of a run's files, the digest of its model, its uncertainty."""
        run = Run.open(self.root / name)
        names = sorted(str(p.relative_to(run.path)) for p in run.path.rglob("*"))
        found = run.load_uncertainty()
        return names, model_hash(run.path), b"" if found is None else found.tobytes()

    def check(self, name: str, how: str) -> None:
        """Let the run finish, and compare. Raises AssertionError."""
        self._must(lambda: self.train(name))
        found = self.content(name)
        for what, one, other in zip(("files", "model", "uncertainty"), found, self.expected, strict=True):
            if one != other:
                raise AssertionError(f"{self.preset}, {how}: {what} {one!r:.300}, undisturbed {other!r:.300}")

    def random_kills(self, kills: int, seed: int) -> int:
        """Kills at random moments, up to five in one run. Returns how many struck before the end."""
        rng, struck, number = random.Random(seed), 0, 0
        while struck < kills:
            name, number = f"random_{number}", number + 1
            moments = [rng.uniform(0.0, 1.1 * self.seconds) for _ in range(rng.randint(1, 5))]
            for moment in moments:
                struck += os.WIFSIGNALED(in_child(lambda n=name: self.train(n), self.said, moment))  # type: ignore[misc]
            self.check(name, f"killed after {', '.join(f'{m:.3f} s' for m in moments)}")
        return struck

    def kills_after_renames(self, most: int = 1000, step: int = 1) -> int:
        """A kill after the first rename of a run, `step` renames later in another, and so on, the last one after at
        most `most`. Returns how many."""
        numbers = range(1, most + 1, step)
        for i, n in enumerate(numbers):
            name = f"rename_{n}"
            if not os.WIFSIGNALED(in_child(lambda: self.train_until_rename(name, n), self.said)):  # noqa: B023
                return i
            self.check(name, f"killed after rename {n}")
        return len(numbers)


def main() -> int:
    """Prints what was done; ends with an AssertionError where something was lost."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=10, help="at random moments (10)")
    parser.add_argument("--renames", type=int, default=1000, help="kills after a rename, at most (1000)")
    parser.add_argument("--step", type=int, default=1, help="renames from one kill to the next run's (1)")
    parser.add_argument("--preset", choices=list(SETTINGS), default="modal")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="tg4mm-kills-") as folder:
        trial = Trial(Path(folder), args.preset)
        print(f"{args.preset}: a training takes {trial.seconds:.1f} s", flush=True)
        if args.renames:
            killed = trial.kills_after_renames(args.renames, args.step)
            print(f"{killed} kills after a rename: nothing lost", flush=True)
        if args.kills:
            struck = trial.random_kills(args.kills, args.seed)
            print(f"{struck} kills at random moments, seed {args.seed}: nothing lost", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
