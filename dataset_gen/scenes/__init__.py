"""The built-in scenes, by name: each module's `build()` describes one at rest."""

from collections.abc import Callable
from importlib import import_module

from ..scene import Scene

NAMES = ("chair", "drums", "ficus", "hotdog", "lego", "materials", "mic", "ship")


def _builder(name: str) -> Callable[[], Scene]:
    """A scene's module is imported when it is built: each paints its textures with much numpy."""
    return lambda: import_module(f"{__name__}.{name}").build()


SCENES: dict[str, Callable[[], Scene]] = {name: _builder(name) for name in NAMES}
