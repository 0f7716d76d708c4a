"""The preset `paper`: [TG4MM] as published. A space triplane, then one motion triplane for each timestep."""

from tg4mm.research.paper.config import PAPER, PAPER_TUNED, PaperConfig
from tg4mm.research.paper.model import PaperModel
from tg4mm.research.paper.motion import train_timesteps
from tg4mm.research.paper.space import first_views, train_triplane

__all__ = [
    "PAPER",
    "PAPER_TUNED",
    "PaperConfig",
    "PaperModel",
    "first_views",
    "train_timesteps",
    "train_triplane",
]
