"""EXR images: linear light with premultiplied alpha → RGBA, straight alpha, display-referred sRGB, 16 bits."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from tg4mm.core.colour import to_display
from tg4mm.core.errors import CaptureError
from tg4mm.core.extras import install
from tg4mm.core.pictures.png16 import MAX_PIXELS

SIGNATURE = b"\x76\x2f\x31\x01"


def size(path: Path) -> tuple[int, int]:
    """Width and height in pixels, from the header; CaptureError if the file is no EXR that `decode` takes."""
    width, height, names = _header(path)
    _channels(path, names)
    return width, height


def _header(path: Path) -> tuple[int, int, list[str]]:
    with _opened(path, header_only=True) as file, _damage_told(path):
        header = file.header()
        first, last = (np.asarray(corner, np.int64) for corner in header["dataWindow"])
        if not np.array_equal(header["dataWindow"], header["displayWindow"]) or first.any():
            raise CaptureError(
                f"{path}: its pixels span {first.tolist()} to {last.tolist()}, not its whole picture; "
                "write it uncropped"
            )
        names = [channel.name for channel in header["channels"]]
    width, height = (last + 1).tolist()
    if not 0 < width * height <= MAX_PIXELS:
        raise CaptureError(f"{path}: has {width}×{height} pixels, more than {MAX_PIXELS}")
    return width, height, names


def decode(path: Path) -> np.ndarray:
    """[H, W, 4] uint16: colour divided by alpha, clipped to 0 … 1, sRGB encoded; opaque if there is no A.

    Colours are taken as linear Rec.709. Raises CaptureError as `linear` does.
    """
    rgba = linear(path)
    alpha = np.clip(rgba[..., 3:], 0, 1)
    colour = np.clip(np.divide(rgba[..., :3], alpha, out=np.zeros_like(rgba[..., :3]), where=alpha > 0), 0, 1)
    return np.floor(np.concatenate([to_display(colour), alpha], axis=-1) * 65535 + 0.5).astype(np.uint16)


def linear(path: Path) -> np.ndarray:
    """Read pixels [H, W, 4] float32 as they are stored, colours premultiplied by alpha.

    A grey channel Y stands for all three colours; alpha is 1 where the file has no A.

    Raises CaptureError if the package OpenEXR is absent, the file damaged, a number in it NaN or infinite, or its
    channels are not R, G, B or Y with or without A.
    """
    width, height = size(path)
    pixels = _pixels(path)
    rgb, alpha = _channels(path, list(pixels))
    found = _stacked(path, pixels, (*rgb, *([alpha] if alpha else [])), (height, width))
    return found if alpha else np.concatenate([found, np.ones_like(found[..., :1])], axis=-1)


def channels(path: Path, names: Sequence[str], wanted: tuple[int, int] | None = None) -> np.ndarray:
    """[H, W, C] float32 of the channels `names` of a picture, of the width and height `wanted` if given.

    Raises CaptureError where they are not there, of another size, or not finite.
    """
    width, height, there = _header(path)
    if missing := [name for name in names if name not in there]:
        raise CaptureError(
            f"{path}: has no channel {missing[0]}; there is {', '.join(sorted(there))[:60] or 'none'}"
        )
    if wanted is not None and (width, height) != wanted:
        raise CaptureError(f"{path}: has {width}×{height} pixels; expected {wanted[0]}×{wanted[1]}")
    return _stacked(path, _pixels(path), names, (height, width))


def _pixels(path: Path) -> dict[str, np.ndarray]:
    with _opened(path, header_only=False) as file, _damage_told(path):
        return {name: channel.pixels for name, channel in file.channels().items()}


def _stacked(
    path: Path, pixels: Mapping[str, np.ndarray], names: Sequence[str], shape: tuple[int, int]
) -> np.ndarray:
    if any(pixels.get(name) is None or pixels[name].shape != shape for name in names):
        raise CaptureError(f"{path}: cannot be decoded: its channels differ in size")
    numbers = np.stack([pixels[name].astype(np.float32) for name in names], axis=-1)
    if not np.isfinite(numbers).all():
        raise CaptureError(f"{path}: holds {numbers[~np.isfinite(numbers)][0]}; expected finite numbers")
    return numbers


def _channels(path: Path, names: list[str]) -> tuple[tuple[str, str, str], str | None]:
    """Names of the colour channels and of alpha."""
    alpha = "A" if "A" in names else None
    if {"R", "G", "B"} <= set(names):
        return ("R", "G", "B"), alpha
    if "Y" in names and not {"RY", "BY"} & set(names):
        return ("Y", "Y", "Y"), alpha
    raise CaptureError(f"{path}: has channels {', '.join(sorted(names)) or 'none'}; expected R, G, B or Y")


def _opened(path: Path, header_only: bool) -> Any:
    with _damage_told(path):
        return _package(path).File(str(path), separate_channels=True, header_only=header_only)


@contextmanager
def _damage_told(path: Path) -> Iterator[None]:
    """Convert the package's exceptions for damaged, foreign or missing files to CaptureError."""
    try:
        yield
    except CaptureError:
        raise
    except (RuntimeError, ValueError, KeyError, MemoryError) as error:
        raise CaptureError(f"{path}: cannot be decoded: the EXR is truncated or damaged") from error


def _package(path: Path) -> ModuleType:
    try:
        import OpenEXR
    except ImportError as error:
        raise CaptureError(f"{path}: EXR images need the package OpenEXR: {install('core')}") from error
    return OpenEXR
