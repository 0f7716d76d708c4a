"""Vibration as data: mode shapes as displacement fields on the rest vertices, times a law in time."""

from .describe import MotionDescription, read_motion
from .fields import Body, Field, Mode
from .motion import Motion, State, pixel_displacement, reach, solve
from .values import SINE, DampedSinusoid, Ramp, TimeLaw

__all__ = [
    "SINE",
    "Body",
    "DampedSinusoid",
    "Field",
    "Mode",
    "Motion",
    "MotionDescription",
    "Ramp",
    "State",
    "TimeLaw",
    "pixel_displacement",
    "reach",
    "read_motion",
    "solve",
]  # fmt: skip
