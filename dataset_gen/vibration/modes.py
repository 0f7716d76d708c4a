"""A mode of vibration as it is described: which field, how far, how fast, which parts, magnified or not."""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from .fields import Field, body_seed
from .geometry import phasor
from .timelaw import TimeLaw, Vibration

RANDOM = "random"


@dataclass(frozen=True)
class Mode:
    """One mode. Exactly one of `amplitude` and `amplitude_px` is given.

    The amplitude is the largest displacement over all vertices of the scene and over a cycle: in scene units (of
    a drift: scene units per second), or in pixels of the reference camera.
    """

    name: str
    field: Field
    law: TimeLaw
    amplitude: float | None = None
    amplitude_px: float | None = None
    phase: float = 0.0  # degrees; 0 is a sine, at rest at t = 0
    phases: tuple[tuple[str, float], ...] | str = ()  # further degrees per part: (glob, degrees), or RANDOM
    parts: tuple[str, ...] = ()  # globs of the parts that move; () is every part
    magnified: bool = True  # False: α leaves it alone

    @property
    def kind(self) -> str:
        return self.field.kind

    @property
    def frequency_hz(self) -> float:
        """0 for a drift."""
        return self.law.frequency_hz

    @property
    def steady(self) -> bool:
        """Whether it goes on for ever, the same in every period."""
        return isinstance(self.law, Vibration) and self.law.decay_s is None

    def moves(self, part: str) -> bool:
        """Whether a part takes part in the mode."""
        return not self.parts or any(fnmatchcase(part, glob) for glob in self.parts)

    def phasor(self, part: str, seed: int) -> complex:
        """exp(i · phase) of a part; of several globs that match it the last one counts."""
        if isinstance(self.phases, str):
            rng = np.random.default_rng([seed, body_seed(self.name), body_seed(part)])
            return complex(phasor(self.phase + rng.uniform(0.0, 360.0)))
        extra = [degrees for glob, degrees in self.phases if fnmatchcase(part, glob)]
        return complex(phasor(self.phase + (extra[-1] if extra else 0.0)))
