"""TG4MM in Blender: import a splat file, play its motion, magnify it with a slider."""

from . import operators, panel, preferences

_MODULES = (preferences, operators, panel)


def register() -> None:
    """Called by Blender when the extension is enabled."""
    for module in _MODULES:
        module.register()


def unregister() -> None:
    """Called by Blender when the extension is disabled."""
    for module in reversed(_MODULES):
        module.unregister()
