"""Packages that an installation may lack: the extra of tg4mm that brings each, and names imported when asked for."""

import importlib
from collections.abc import Callable, Mapping
from typing import Any

# Import names. What needs torch needs the rest of `core`, too.
_CORE = (
    "torch numba scipy skimage safetensors OpenEXR jinja2 markupsafe imageio imageio_ffmpeg av psutil filelock"
    " plenoptic matplotlib pyuff h5py openpyxl yaml"
)
EXTRA_OF = {
    **dict.fromkeys(_CORE.split(), "core"),
    "bpy": "generate",
    "flip_evaluator": "flip",
    "gsplat": "cuda",
    "pycolmap": "sfm",
    "viser": "view",
    "pxr": "usd",
    "playwright": "pdf",
    "pyoma2": "modal",
    "sdypy": "modal",
}
# All that a command needs, where that is more than `core` or less.
EXTRAS_OF_COMMAND = {
    "demo": ("core", "generate"),
    "process": ("core", "sfm"),
    "sfm": ("sfm",),
    "view": ("core", "view"),
}


def install(*extras: str) -> str:
    """The command that installs extras into an environment that has tg4mm, quoted for any shell."""
    return f'pip install "tg4mm[{",".join(extras)}]"'


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
