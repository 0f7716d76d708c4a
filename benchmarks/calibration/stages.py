"""What each method says of a film."""

from __future__ import annotations

import time
from pathlib import Path

from benchmarks.calibration.draw import Truth
from benchmarks.calibration.score import Named, Score, score
from tg4mm.capture.look import look


def look_stage(video: Path, truth: Truth, python: str) -> dict[str, Score]:
    """One pass over the video."""
    began = time.process_time()
    found = look(video)
    seconds = time.process_time() - began
    named = [
        Named(
            *(line.hz, line.hz_deviation, line.amplitude_px, line.amplitude_deviation_px),
            *(line.damping, line.damping_deviation, line.from_s, line.centre_px, bool(line.mark)),
        )
        for line in found.lines
    ]
    return {"look": score(truth, named, seconds)}


def whole_stage(video: Path, truth: Truth, python: str) -> dict[str, Score]:
    raise NotImplementedError


def baselines_stage(video: Path, truth: Truth, python: str) -> dict[str, Score]:
    raise NotImplementedError
