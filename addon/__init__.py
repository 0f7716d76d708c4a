"""TG4MM in Blender: import a splat file, play its motion, magnify it with a slider."""

from . import jobs, operators, overlay, panel, panel_probe, pictures, preferences, view_settings

_MODULES = (preferences, view_settings, pictures, operators, panel, panel_probe, overlay, jobs)


def register() -> None:
    """Called by Blender when the extension is enabled."""
    for module in _MODULES:
        module.register()


def unregister() -> None:
    """Called by Blender when the extension is disabled."""
    for module in reversed(_MODULES):
        module.unregister()
