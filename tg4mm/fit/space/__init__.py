"""The space stage: static Gaussians of the scene at rest ([TG4MM] phase 1, [3DGS]).

The names are imported when they are first asked for: the settings need no torch.
"""

from typing import TYPE_CHECKING

from tg4mm.core.extras import lazily

if TYPE_CHECKING:
    from tg4mm.fit.space.config import SpaceConfig
    from tg4mm.fit.space.targets import RestViews, rest_views

__all__ = ["RestViews", "SpaceConfig", "rest_views"]

__getattr__ = lazily(__name__, {"RestViews": "targets", "SpaceConfig": "config", "rest_views": "targets"})
