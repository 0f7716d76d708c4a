"""The space stage: static Gaussians of the scene at rest ([TG4MM] phase 1, [3DGS])."""

from tg4mm.space.config import SpaceConfig
from tg4mm.space.stage import train_plane, train_space
from tg4mm.space.targets import RestViews, rest_views

__all__ = ["RestViews", "SpaceConfig", "rest_views", "train_plane", "train_space"]
