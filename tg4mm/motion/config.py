"""Settings of the motion stage, preset `modal`."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MotionConfig:
    """How the motion is fitted. The weights are relative to what the images say about a Gaussian on average."""

    components: int = 16  # at most so many temporal components; fewer where the rest is noise
    neighbours: float = (
        0.0  # weight of the term that keeps neighbourhoods rigid; 0: found from the images, `weight.py`
    )
    ridge: float = 1e-3  # weight that draws motion to zero where nothing is known
    triplane: int = 16  # finest resolution of the motion triplane: 8, 16, 32 …
    iterations: int = 20  # of conjugate gradients, at most, for each component
    tolerance: float = 5e-3  # relative residual at which conjugate gradients stop
    halves: bool = (
        True  # fit each half of the cameras by itself and take the mean, which costs no more: `halves.py`
    )
    seed: int = 0
