"""What the motion stage found."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tg4mm.gaussians import Gaussians
from tg4mm.motion.config import MotionConfig
from tg4mm.motion.modes import ModalMotion


@dataclass(frozen=True)
class MotionFit:
    """What `fit_motion` gives: the scene at rest, its motion, how sure it is, and what the capture cannot tell."""

    gaussians: Gaussians  # at rest; others than those given where large motion made them sharper
    motion: ModalMotion  # displacement and rotation phasors of every Gaussian
    uncertainty: dict[
        str, np.ndarray
    ]  # RUN/uncertainty.safetensors (docs/conventions.md); empty: not asked for
    figures: dict[str, Any]  # for the log
    notes: list[str] = field(default_factory=list)  # what cannot be told, a line each
    config: MotionConfig = field(default_factory=MotionConfig)  # it was asked for with
