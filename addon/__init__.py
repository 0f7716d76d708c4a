"""TG4MM in Blender: import a splat file, play its motion, magnify it with a slider."""

from . import jobs, preferences
from .io import export_splat, import_splat
from .panels import colour_range, crop, look, overlay, panel, pictures, view_settings
from .probe import operators as probe_operators
from .probe import panel as panel_probe

_MODULES = (
    *(preferences, view_settings, colour_range, pictures, import_splat, export_splat, look),
    *(probe_operators, panel, panel_probe, crop, overlay, jobs),
)


def register() -> None:
    """Called by Blender when the extension is enabled."""
    for module in _MODULES:
        module.register()


def unregister() -> None:
    """Called by Blender when the extension is disabled."""
    for module in reversed(_MODULES):
        module.unregister()
