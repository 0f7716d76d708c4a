"""Background jobs: dataset generation from the open scene and training, with panels and settings."""

from . import commands, core_check, operators, panels, settings

_MODULES = (settings, commands, core_check, operators, panels)


def register() -> None:
    for module in _MODULES:
        module.register()


def unregister() -> None:
    for module in reversed(_MODULES):
        module.unregister()
