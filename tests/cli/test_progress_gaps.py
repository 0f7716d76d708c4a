"""A user sees all the time that something goes on: hardly any work of a command lies outside of progress.

Counted is processor time, which other work on the machine does not change, in a second call, when all is imported and
compiled. What is short here is long for real data, so a gap counts by its share of the command.
"""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.capture.sfm.videos import still, write_video
from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.cli import main
from tg4mm.core import progress as module

SHARE = 0.2  # of a command's processor time, at most, between one progress and the next
LEAST_S = 0.5  # shorter ones do not count
# The motion stage says nothing while it estimates the noise and builds the operators that the smoothness is chosen by.
KNOWN = {"space stage … smoothness": 0.6}
SETTINGS = ("space.iterations=150", "space.max_gaussians=5000", "motion.iterations=6")


class Meter:
    """Processor time that passes while nothing is shown, by what came before."""

    def __init__(self) -> None:
        self.began = self.since = time.process_time()
        self.depth, self.last = 0, "the start"
        self.gaps: list[tuple[float, str]] = []  # seconds, between which labels

    def enter(self, label: str) -> None:
        if self.depth == 0:
            self.gaps.append((time.process_time() - self.since, f"{self.last} … {label}"))
        self.depth += 1

    def leave(self, label: str) -> None:
        self.depth, self.last, self.since = self.depth - 1, label, time.process_time()

    def longest(self) -> tuple[float, str, float]:
        """(seconds, between which labels, seconds of all)."""
        self.enter("the end")
        return *max(self.gaps), time.process_time() - self.began


def measured(call: Callable[[], object], monkeypatch: pytest.MonkeyPatch) -> tuple[float, str, float]:
    meter, lines = Meter(), module._lines

    @contextlib.contextmanager
    def watched(label: str, *rest) -> Iterator[module.Update]:
        meter.enter(label)
        try:
            with lines(label, *rest) as update:
                yield update
        finally:
            meter.leave(label)

    with monkeypatch.context() as patch:
        patch.setattr(module, "_lines", watched)
        call()
    return meter.longest()


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset and a run."""
    root = tmp_path_factory.mktemp("made")
    make_synthetic_dataset(
        root / "set", n_views=8, n_timesteps=12, size=96, freqs=(5.0,), alphas=(5,), n_test=2, detail=2
    )
    write_video(root / "a.mp4", still(60))
    assert main(train(root, root / "run")) == 0
    return root


def train(made: Path, out: Path) -> list[str]:
    return ["train", str(made / "set"), "--out", str(out), *(p for s in SETTINGS for p in ("--set", s))]


COMMANDS: dict[str, Callable[[Path, Path], list[str]]] = {
    "train": train,
    "sfm": lambda made, out: ["sfm", str(made / "a.mp4"), "--out", str(out)],
    "render": lambda made, out: ["render", str(made / "run"), "--alpha", "5", "--out", str(out)],
    "evaluate": lambda made, out: ["evaluate", str(made / "run"), "--out", str(out / "metrics.json")],
    "measure": lambda made, out: [
        "measure",
        str(made / "run"),
        "--out",
        str(out),
        "--no-keep",
        "--no-animate",
    ],
    "report": lambda made, out: ["report", str(made / "run"), "--out", str(out / "report.html")],
}


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_no_stage_of_a_command_is_silent(
    command: str,
    made: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("TG4MM_EVENTS", "json")
    words = COMMANDS[command]
    assert main(words(made, tmp_path / "first")) == 0
    gap, where, total = measured(lambda: main(words(made, tmp_path / "second")), monkeypatch)
    assert gap < max(LEAST_S, KNOWN.get(where, SHARE) * total), f"{where}: {gap:.2f} s of {total:.2f} s"
    events = [
        json.loads(line) for line in capsys.readouterr().err.splitlines() if line.startswith('{"tg4mm"')
    ]
    shown = [e for e in events if e["tg4mm"] == "progress"]
    assert shown
    assert all(e["label"] for e in shown)
