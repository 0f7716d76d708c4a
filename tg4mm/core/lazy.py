"""Packages whose names are imported when they are first asked for."""

import importlib
from collections.abc import Callable, Mapping
from typing import Any

from tg4mm.core.extras import EXTRA_OF, install


def lazily(package: str, where: Mapping[str, str]) -> Callable[[str], Any]:
    """`__getattr__` of a package: `where` names the module of each of its names, relative to it.

    A name that is its module's own means the module.
    """

    def get(name: str) -> Any:
        if name not in where:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        try:
            module = importlib.import_module(f"{package}.{where[name]}")
        except ModuleNotFoundError as error:
            if error.name is None or error.name.split(".")[0] == "tg4mm":
                raise
            raise ModuleNotFoundError(
                f"{package}.{name} needs {error.name}: {install(EXTRA_OF.get(error.name.split('.')[0], 'core'))}",
                name=error.name,
            ) from error
        return module if where[name] == name else getattr(module, name)

    return get
