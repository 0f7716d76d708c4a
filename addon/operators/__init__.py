"""Operators: each reads its properties, calls a plain function and reports."""

from . import import_splat, look

_MODULES = (import_splat, look)


def register() -> None:
    for module in _MODULES:
        module.register()


def unregister() -> None:
    for module in reversed(_MODULES):
        module.unregister()
