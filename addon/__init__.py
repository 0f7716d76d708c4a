"""TG4MM in Blender: import a splat file, play its motion, magnify it with a slider."""

from . import colour_range, jobs, operators, overlay, panel, panel_probe, pictures, preferences, view_settings

_MODULES = (preferences, view_settings, colour_range, pictures, operators, panel, panel_probe, overlay, jobs)


def register() -> None:
    """Called by Blender when the extension is enabled."""
    for module in _MODULES:
        module.register()


def unregister() -> None:
    """Called by Blender when the extension is disabled."""
    for module in reversed(_MODULES):
        module.unregister()
