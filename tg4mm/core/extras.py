"""Packages that an installation may lack: the extra of tg4mm that brings each, and the command that installs it."""

from __future__ import annotations

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
