"""Operators: each reads its properties, calls a plain function and reports."""

from .io import export_splat, import_splat
from .panels import band, look
from .probe import operators as probe

_MODULES = (import_splat, export_splat, look, band, probe)


def register() -> None:
    for module in _MODULES:
        module.register()


def unregister() -> None:
    for module in reversed(_MODULES):
        module.unregister()
