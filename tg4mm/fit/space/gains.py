"""What a camera that sets its own exposure and white balance does to its pictures: a gain for each and each channel.

A picture is taken for the scene times its gain. Given the scene, the gain that fits best is a quotient of sums, so none
is descended to: each time a picture is seen, its gain moves part of the way there. Only ratios can be told from
pictures, so the geometric mean of each channel's gains over all pictures is held at one.
"""

from __future__ import annotations

from typing import Any

from torch import Tensor

RATE = 0.1  # of the way, each time
EVERY = 4  # pixels: one of so many in each direction is looked at
BRIGHTEST = 250 / 255  # what is brighter may have been clipped, whatever the exposure
MOST = 4.0  # and 1 / MOST: no gain lies further from one


def fitting_gain(rendered: Any, target: Any) -> Any:
    """[3] gains that bring `rendered` closest to `target`, both [H, W, 3], torch tensors or numpy arrays.

    Least squares over the pixels that are not clipped; where there are none, 1.
    """
    seen = target < BRIGHTEST
    squares = (rendered * rendered * seen).sum((0, 1))
    return ((rendered * target * seen).sum((0, 1)) + 1e-6) / (squares + 1e-6)


def moved(gains: Tensor, v: int, fitting: Tensor) -> Tensor:
    """Gains [V, 3] after picture v was seen, which `fitting` [3] would suit best."""
    logs = gains.log()
    logs[v] += RATE * (fitting.clamp(1 / MOST, MOST).log() - logs[v])
    return (logs - logs.mean(0)).exp()
