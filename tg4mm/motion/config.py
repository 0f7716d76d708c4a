"""Settings of the motion stage, preset `modal`."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MotionConfig:
    """How the motion is fitted. The weights are relative to what the images say about a Gaussian on average."""

    components: int = 16  # at most so many temporal components; fewer where the rest is noise
    neighbours: float = 500.0  # weight of the term that keeps neighbourhoods rigid
    ridge: float = 1e-3  # weight that draws motion to zero where nothing is known
    triplane: int = 16  # finest resolution of the motion triplane: 8, 16, 32 …
    iterations: int = 80  # of conjugate gradients, at most, for each component
    tolerance: float = 3e-3  # relative residual at which conjugate gradients stop
    halves: bool = True  # fit each half of the cameras too, which takes twice as long: `halves.py`
    seed: int = 0
