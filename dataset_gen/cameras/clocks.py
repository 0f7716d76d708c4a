"""When a training camera takes its pictures: its own clock, the scene's, and how they are apart.

The scene's clock is the one that the exact motion and the test views go by, and it is camera 0's: a time that
all clocks are off by cannot be told from pictures. A picture at timestep t is taken at t / fps on its camera's
own clock, which the pose file says, and at t / fps + offset on the scene's, which only the truth says.
"""

from __future__ import annotations

import functools

import numpy as np

from .camera import Camera
from .setup import CameraSetup

_SHORTEST_PAUSE, _LONGEST_PAUSE = 2.0, 10.0  # seconds between clips: the camera is carried to its next place
_DIGITS = 6  # of a second


def scene_time(setup: CameraSetup, camera: Camera, timestep: int) -> float | None:
    """Seconds on the scene's clock at which a training camera takes this picture; None: the scene is at rest."""
    if not films(setup, camera):
        return None
    return timestep / setup.fps + clock_offsets(setup)[camera.index]


def films(setup: CameraSetup, camera: Camera) -> bool:
    """Whether a training camera records over time; the pictures of a sweep show the scene before it moves."""
    return setup.kind != "sweep" or camera.index == 0


@functools.lru_cache(maxsize=64)
def clock_offsets(setup: CameraSetup) -> tuple[float, ...]:
    """Seconds from the scene's clock to that of each camera that films, the first 0.

    Cameras that were not started together differ by up to `clock_offsets` either way. Clips follow one another
    with pauses of 2 to 10 seconds, so that each has a phase of its own at every frequency.
    """
    count = 1 if setup.kind == "sweep" else setup.n_train(0)
    rng = np.random.default_rng([setup.seed, 0xC10C])
    if setup.kind == "clips":
        length = setup.n_timesteps / setup.fps
        pauses = rng.uniform(_SHORTEST_PAUSE, _LONGEST_PAUSE, count - 1)
        offsets = np.cumsum([0.0, *(length + pauses)])
    else:
        offsets = np.array([0.0, *rng.uniform(-setup.clock_offset_s, setup.clock_offset_s, count - 1)])
    return tuple((offsets.round(_DIGITS) + 0.0).tolist())
