"""Video quality without a reference, by a user's own checkout of MD-VQA or FAST-VQA, run as a program on a video.

Neither is part of this program, nor are their weights. MD-VQA: the authors' `test_video.py`; FAST-VQA: the authors'
`vqa.py`. Both print the score as the last number of their last line.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tg4mm.research.bench import BenchError
from tg4mm.show.render.video import loops_to_last, write_mp4

_SECONDS = 4.0  # that a video lasts, by repetition
_MINUTES = 30  # after which a program is stopped
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
# {metric: arguments before the video's name, run by Python in the checkout's folder}
PROGRAMS = {"md_vqa": ("test_video.py", "-i"), "fast_vqa": ("vqa.py", "-m", "FAST-VQA", "-v")}
OPTIONS = {"md_vqa": "--md-vqa", "fast_vqa": "--fast-vqa"}


@dataclass(frozen=True)
class Checkout:
    """A metric's program where the user has it."""

    metric: str  # of PROGRAMS
    folder: Path
    python: str = "python3"  # which has what the checkout needs: often another environment than this one

    @property
    def program(self) -> Path:
        return self.folder / PROGRAMS[self.metric][0]

    def checked(self) -> Checkout:
        """Itself. Raises BenchError where the program is not there."""
        if not self.program.is_file():
            raise BenchError(f"{OPTIONS[self.metric]} {self.folder}: holds no {self.program.name}")
        return self

    def __call__(self, video: np.ndarray, fps: float) -> float:
        """The score of a video [T, H, W, 3] uint8. Raises BenchError where the program fails or prints no number."""
        with tempfile.TemporaryDirectory(prefix="tg4mm-") as folder:
            path = Path(folder) / "video.mp4"
            write_mp4(path, list(video), fps, loops_to_last(len(video), fps, _SECONDS), 1, quality=12)
            return self._run(path)

    def _run(self, path: Path) -> float:
        command = [self.python, *PROGRAMS[self.metric], str(path)]
        where = f"{OPTIONS[self.metric]} {self.folder}"
        try:
            done = subprocess.run(
                command,
                cwd=self.folder,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=60 * _MINUTES,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise BenchError(f"{where}: {' '.join(command[:2])} did not run: {error}") from None
        if done.returncode != 0:
            said = (done.stderr.strip() or done.stdout.strip() or "no message").splitlines()[-1]
            raise BenchError(f"{where}: ended with status {done.returncode}: {said[:200]}")
        last = (done.stdout.strip().splitlines() or [""])[-1]
        found = _NUMBER.findall(last)
        if not found:
            raise BenchError(
                f"{where}: the last line that it printed is {last[:200]!r}, expected one with the score"
            )
        return float(found[-1].rstrip("."))


def checkouts(folders: Mapping[str, Path | None], python: str) -> tuple[Checkout, ...]:
    """Those that are given. Raises BenchError for a folder without the program."""
    return tuple(Checkout(m, f.resolve(), python).checked() for m, f in folders.items() if f is not None)
