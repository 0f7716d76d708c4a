"""The Geometry Nodes trees, built in code: one builder for each node group."""

from .player import Content, build_player
from .shapes import Materials

__all__ = ["Content", "Materials", "build_player"]
