"""Background jobs: dataset generation from the open scene and training, with panels, settings and preview."""

from . import commands, core_check, operators, panels, preview, settings

_MODULES = (settings, preview, commands, core_check, operators, panels)


def register() -> None:
    for module in _MODULES:
        module.register()


def unregister() -> None:
    for module in reversed(_MODULES):
        module.unregister()
