"""EXR images: linear light with premultiplied alpha → RGBA, straight alpha, display-referred sRGB, 16 bits."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from tg4mm.capture.png16 import MAX_PIXELS
from tg4mm.errors import CaptureError

SIGNATURE = b"\x76\x2f\x31\x01"


def size(path: Path) -> tuple[int, int]:
    """Width and height in pixels, from the header; CaptureError if the file is no EXR that `decode` takes."""
    with _opened(path, header_only=True) as file:
        header = file.header()
        first, last = (np.asarray(corner, np.int64) for corner in header["dataWindow"])
        if not np.array_equal(header["dataWindow"], header["displayWindow"]) or first.any():
            raise CaptureError(
                f"{path}: its pixels span {first.tolist()} to {last.tolist()}, not its whole picture; "
                "write it uncropped"
            )
        _channels(path, [channel.name for channel in header["channels"]])
    width, height = (last + 1).tolist()
    if not 0 < width * height <= MAX_PIXELS:
        raise CaptureError(f"{path}: has {width}×{height} pixels, more than {MAX_PIXELS}")
    return width, height


def decode(path: Path) -> np.ndarray:
    """[H, W, 4] uint16: colour divided by alpha, clipped to 0 … 1, sRGB encoded; opaque if there is no A.

    Colours are taken as linear Rec.709, a grey channel Y as all three. Raises CaptureError if the package OpenEXR is
    absent, the file damaged, a number in it NaN or infinite, or its channels are not R, G, B or Y with or
    without A.
    """
    width, height = size(path)
    with _opened(path, header_only=False) as file:
        try:
            pixels = {name: channel.pixels for name, channel in file.channels().items()}
        except (RuntimeError, ValueError) as error:
            raise CaptureError(f"{path}: cannot be decoded: the EXR is truncated or damaged") from error
    rgb, alpha = _channels(path, list(pixels))
    wanted = [pixels[name] for name in (*rgb, *([alpha] if alpha else []))]
    if any(channel is None or channel.shape != (height, width) for channel in wanted):
        raise CaptureError(f"{path}: cannot be decoded: its channels differ in size")
    numbers = np.stack([channel.astype(np.float32) for channel in wanted], axis=-1)
    if not np.isfinite(numbers).all():
        raise CaptureError(f"{path}: holds {numbers[~np.isfinite(numbers)][0]}; expected finite numbers")
    return _display(numbers)


def _display(premultiplied: np.ndarray) -> np.ndarray:
    """[H, W, 3 or 4] linear → [H, W, 4] uint16."""
    rgba = np.ones((*premultiplied.shape[:2], 4), np.float32)
    rgba[..., : premultiplied.shape[2]] = premultiplied
    alpha = np.clip(rgba[..., 3:], 0, 1)
    linear = np.clip(np.divide(rgba[..., :3], alpha, out=np.zeros_like(rgba[..., :3]), where=alpha > 0), 0, 1)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.floor(np.concatenate([srgb, alpha], axis=-1) * 65535 + 0.5).astype(np.uint16)


def _channels(path: Path, names: list[str]) -> tuple[tuple[str, str, str], str | None]:
    """Names of the colour channels and of alpha."""
    alpha = "A" if "A" in names else None
    if {"R", "G", "B"} <= set(names):
        return ("R", "G", "B"), alpha
    if "Y" in names and not {"RY", "BY"} & set(names):
        return ("Y", "Y", "Y"), alpha
    raise CaptureError(f"{path}: has channels {', '.join(sorted(names)) or 'none'}; expected R, G, B or Y")


def _opened(path: Path, header_only: bool) -> Any:
    try:
        return _package(path).File(str(path), separate_channels=True, header_only=header_only)
    except RuntimeError as error:  # what the package raises for a file that is torn, foreign or absent
        raise CaptureError(f"{path}: cannot be decoded: the EXR is truncated or damaged") from error


def _package(path: Path) -> ModuleType:
    try:
        import OpenEXR
    except ImportError as error:
        raise CaptureError(
            f"{path}: EXR images need the package OpenEXR: pip install 'OpenEXR>=3.3'"
        ) from error
    return OpenEXR
