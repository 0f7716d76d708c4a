"""Settings of the motion stage, preset `modal`."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MotionConfig:
    """How the motion is fitted. The weights are relative to what the images say about a Gaussian on average."""

    components: int = 16  # at most so many temporal components; fewer where the rest is noise
    neighbours: float = 0.0  # weight of the term that makes neighbours move alike; 0: found from the images
    ridge: float = 1e-3  # weight that draws motion to zero where nothing is known
    iterations: int = 30  # of conjugate gradients, at most, for each component
    tolerance: float = 3e-3  # relative residual at which conjugate gradients stop
    halves: bool = (
        True  # fit each half of the cameras by itself and take the mean, which costs no more: `halves.py`
    )
    seed: int = 0
