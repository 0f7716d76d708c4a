"""Vibration as data: mode shapes as displacement fields on the rest vertices, times a law in time.

numpy only; no Blender. What moves and how is described in YAML (describe.py), solved on meshes into a
Motion (motion.py) that is exactly linear in the gain of every mode. The convention of phases: values.py.
"""

from .describe import MotionDescription, read_motion
from .fields import Body, Field, Mode
from .motion import Motion, State, pixel_displacement, reach, solve
from .values import SINE, Ramp, TimeLaw, Vibration

__all__ = [
    "SINE", "Body", "Field", "Mode", "Motion", "MotionDescription", "Ramp", "State", "TimeLaw", "Vibration",
    "pixel_displacement", "reach", "read_motion", "solve",
]  # fmt: skip
