"""Operators: each reads its properties, calls a plain function and reports."""

from . import band, import_splat, look, probe

_MODULES = (import_splat, look, band, probe)


def register() -> None:
    for module in _MODULES:
        module.register()


def unregister() -> None:
    for module in reversed(_MODULES):
        module.unregister()
