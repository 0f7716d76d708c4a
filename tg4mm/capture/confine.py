"""Paths that stay inside the dataset's folder: no reader opens a file elsewhere."""

import os
from pathlib import Path, PurePosixPath, PureWindowsPath

from tg4mm.capture.frames import frame_of
from tg4mm.core.errors import CaptureError

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".exr", ".webp", ".tif", ".tiff")


class MissingPictureError(CaptureError):
    """A picture that a dataset names is not there."""


def portable(folder: Path, name: str) -> str:
    """Return a file's name with the backslashes of Windows as slashes, unless there is a file that is called so."""
    return name.replace("\\", "/") if "\\" in name and not (folder / name).exists() else name


def inside(root: Path, path: Path, where: str) -> Path:
    """`path` unchanged if, links and .. resolved, it lies inside `root`; else CaptureError naming `where`."""
    try:
        leaves = not path.resolve().is_relative_to(root.resolve())
    except (OSError, ValueError, RuntimeError) as error:  # a loop of links, a null byte
        raise CaptureError(f"{where}: {str(path)!r} is not a usable path: {error}") from error
    if leaves:
        raise CaptureError(f"{where}: {path} leads outside the dataset's folder {root}")
    return path


def image_path(root: Path, folder: Path, file_path: str, where: str) -> Path:
    """The image, or the frame of a video, that `file_path` means, relative to `folder`.

    Without a suffix those of `IMAGE_SUFFIXES` are tried. Raises CaptureError if it is absolute, leaves `root`, or is
    not there.
    """
    file_path = portable(folder, file_path)
    if PurePosixPath(file_path).is_absolute() or PureWindowsPath(file_path).drive:
        raise CaptureError(f"{where}: file_path {file_path!r} is absolute; expected one relative to {folder}")
    named = folder / file_path
    frame = frame_of(named)
    if frame is not None:
        if not inside(root, frame[0], where).is_file():
            raise CaptureError(f"{where}: video {frame[0]} does not exist")
        return root / os.path.normpath(
            named.relative_to(root)
        )  # one path for a video, whichever folder names it
    # Without with_suffix: "r_0.05" has no image suffix, and its ".05" must stay.
    has_suffix = named.suffix.lower() in IMAGE_SUFFIXES
    candidates = [named] if has_suffix else [named.with_name(named.name + s) for s in IMAGE_SUFFIXES]
    for candidate in candidates:
        if inside(root, candidate, where).is_file():
            return candidate
    if inside(root, named, where).is_file():
        kinds = ", ".join(IMAGE_SUFFIXES)
        raise CaptureError(f"{where}: image {named} has an unsupported type; expected one of {kinds}")
    tried = "" if has_suffix else f" (tried {', '.join(IMAGE_SUFFIXES)})"
    raise MissingPictureError(f"{where}: image {named} does not exist{tried}")
