"""The motion stage: how every Gaussian moves, and Gaussians moved and magnified."""

from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.modes import ModalMotion, MotionFit

__all__ = ["ModalMotion", "MotionConfig", "MotionFit"]
