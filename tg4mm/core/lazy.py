"""Packages whose names are imported when they are first asked for.

What lies in them and needs no torch (pages, charts, picture files, image metrics) can then be imported without it.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import inspect


def lazily(package: str, where: Mapping[str, str]) -> Callable[[str], Any]:
    """`__getattr__` of a package: `where` names the module of each of its names, relative to it.

    A name that is its module's own means the module.
    """

    def get(name: str) -> Any:
        if name not in where:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module = importlib.import_module(f"{package}.{where[name]}")
        return module if where[name] == name else getattr(module, name)

    return get


class _CallablePackage(ModuleType):
    """A package that can be called as its function of the same name."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return self._function(*args, **kwargs)

    @property
    def __signature__(self) -> inspect.Signature:
        import inspect  # 17 ms, which `import tg4mm` must not take

        return inspect.signature(self._function)

    @property
    def _function(self) -> Callable[..., Any]:
        return getattr(self, self.__name__.rpartition(".")[2])


def callable_package(package: str) -> None:
    """Let a package, called from its `__init__`, be called as its function of the same name.

    `tg4mm.measure(…)` and `tg4mm.show.measure.Sensor` then both work, in whatever order things were imported:
    importing a package's module binds the package's name in `tg4mm`, and would hide a function there.
    """
    sys.modules[package].__class__ = _CallablePackage
