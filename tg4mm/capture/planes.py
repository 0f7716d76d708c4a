"""A decoded frame's pixels: its luma as it is coded, its colours, upright; and what is unusual about them."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

_LOG = logging.getLogger("tg4mm")
_WARNED: set[tuple[Path, str]] = set()
_HDR = {16: "PQ", 18: "HLG"}  # curves, as FFmpeg numbers them
LUMA = np.array([0.299, 0.587, 0.114], np.float32)
_STRAIGHT = 0.01  # of the axes, what they may be aslant
_PLANAR = ("yuv4", "yuvj4", "nv12", "gray")  # pixel formats whose first plane is the luma
_ONE = 1 << 16  # in a display matrix
_TO_RGBA, _BLOCK = ("yuv420p", "yuvj420p"), 16  # formats that FFmpeg makes RGBA of, by blocks of columns


@dataclass(frozen=True)
class Orientation:
    """One of the eight ways in which a stored picture is shown upright: transposed, then mirrored."""

    is_transposed: bool = False
    mirrors_rows: bool = False  # left to right
    mirrors_columns: bool = False  # top to bottom

    def shown(self, stored: np.ndarray) -> np.ndarray:
        """A picture [H, W, ...] as it is shown."""
        out = stored.swapaxes(0, 1) if self.is_transposed else stored
        return out[:: -1 if self.mirrors_columns else 1, :: -1 if self.mirrors_rows else 1]

    def stored(self, shown: np.ndarray) -> np.ndarray:
        """The inverse of `shown`."""
        out = shown[:: -1 if self.mirrors_columns else 1, :: -1 if self.mirrors_rows else 1]
        return out.swapaxes(0, 1) if self.is_transposed else out

    def stored_vector(self, shown: np.ndarray) -> np.ndarray:
        """A vector [2], right and down in the picture that is shown, in the one that is stored."""
        mirrored = shown * np.where([self.mirrors_rows, self.mirrors_columns], -1, 1)
        return mirrored[::-1] if self.is_transposed else mirrored


AS_STORED = Orientation()


def orientation_of(frame: Any) -> Orientation:
    """Return the rotation in a decoded frame's display matrix; other angles than quarter turns are ignored."""
    data = next((bytes(d) for d in frame.side_data if d.type.name == "DISPLAYMATRIX"), b"")
    if len(data) != 36:
        return AS_STORED
    # x' = a x + c y, y' = b x + d y; right and down
    a, b, _, c, d = np.frombuffer(data, np.int32)[:5].astype(float) / _ONE
    is_transposed = abs(b) + abs(c) > abs(a) + abs(d)
    right, down = (c, b) if is_transposed else (a, d)
    rest = (a, d) if is_transposed else (b, c)
    if not np.abs(rest).max() < _STRAIGHT * np.abs([right, down]).min():
        return AS_STORED
    return Orientation(bool(is_transposed), bool(right < 0), bool(down < 0))


def say_what_it_is(path: Path, frame: Any) -> None:
    """Warn once of a file with unusual pictures: interlaced or HDR."""
    text, hdr = "", _HDR.get(int(frame.color_trc))
    if frame.interlaced_frame:
        text = (
            "is interlaced: even and odd rows are of different moments, which shows as motion; film progressively, or "
            "deinterlace it"
        )
    elif hdr:
        text = (
            f"is HDR ({hdr}, {frame.format.components[0].bits} bits): values stay as they are coded; this does "
            "not change motion, but colours look flat"
        )
    say_once(path, text)


def say_once(path: Path, text: str) -> None:
    """A warning about a file, unless it is empty or was given already."""
    if text and (path, text) not in _WARNED:
        _WARNED.add((path, text))
        _LOG.warning(f"{path}: {text}")


def upright(frame: Any, pixels: np.ndarray) -> np.ndarray:
    """A decoded frame's pixels, turned and mirrored as its container asks."""
    return np.ascontiguousarray(orientation_of(frame).shown(pixels))


def luma(frame: Any) -> np.ndarray:
    """Return the luma [H, W], of planar formats as coded: uint8, or for more than 8 bits float32, 0 to 255."""
    name, bits = frame.format.name, frame.format.components[0].bits
    if bits > 8 and name.startswith("yuv4") and name.endswith("le"):
        plane = frame.planes[0]
        values = np.frombuffer(plane, np.uint16).reshape(-1, plane.line_size // 2)
        return values[: frame.height, : frame.width].astype(np.float32) / np.float32(2 ** (bits - 8))
    if _is_deep(frame):
        return np.asarray(frame.to_ndarray(format="gray16le")).astype(np.float32) / np.float32(257)
    if not (name.startswith(_PLANAR) and bits == 8):
        return np.asarray(frame.to_ndarray(format="gray"))
    plane = frame.planes[0]
    return np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)[: frame.height, : frame.width]


def _is_deep(frame: Any) -> bool:
    """Return whether the format is a high-speed camera's grey of more than 8 bits."""
    return frame.format.name.startswith("gray") and frame.format.components[0].bits > 8


def colours(frame: Any) -> np.ndarray:
    """A decoded frame as `VideoFrame` has it, not turned."""
    if not _is_deep(frame):
        return np.asarray(frame.to_ndarray(format="rgb24"))
    grey = np.asarray(frame.to_ndarray(format="gray16le"))
    rgba = np.full((*grey.shape, 4), 65535, np.uint16)
    rgba[..., :3] = grey[..., None]
    return rgba


def opaque(frame: Any) -> np.ndarray:
    """Return a decoded frame as RGBA [H, W, 4], not turned."""
    if frame.format.name in _TO_RGBA and frame.width % _BLOCK == 0:
        # in a fifth of the time; in columns beside whole blocks FFmpeg leaves any values
        rgba = np.asarray(frame.to_ndarray(format="rgba"))
        if rgba[..., 3].min() == 255:
            return rgba
    pixels = colours(frame)
    return pixels if pixels.shape[2] == 4 else np.asarray(Image.fromarray(pixels).convert("RGBA"))
