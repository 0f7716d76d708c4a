"""TG4MM in Blender: import a splat file, play its motion, magnify it with a slider."""

from . import jobs, preferences
from .io import export_splat, import_splat
from .panels import colour_range, crop, look, overlay, panel, pictures
from .probe import mark, picking
from .probe import operators as probe_operators

_MODULES = (
    *(preferences, overlay, colour_range, pictures, import_splat, export_splat, look),
    *(probe_operators, panel, picking, mark, crop, jobs),
)


def register() -> None:
    """Register the extension; Blender calls this when it is enabled."""
    for module in _MODULES:
        module.register()


def unregister() -> None:
    """Unregister the extension; Blender calls this when it is disabled."""
    for module in reversed(_MODULES):
        module.unregister()
