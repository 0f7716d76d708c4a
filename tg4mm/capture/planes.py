"""A decoded frame's pixels: its luma as it is coded, its colours, upright; and what is unusual about them."""

import logging
from pathlib import Path
from typing import Any

import numpy as np

_LOG = logging.getLogger("tg4mm")
_SAID: set[Path] = set()  # of which a warning said what they are
_HDR = {16: "PQ", 18: "HLG"}  # curves, as FFmpeg numbers them
LUMA = np.array([0.299, 0.587, 0.114], np.float32)
_PLANAR = ("yuv4", "yuvj4", "nv12", "gray")  # pixel formats whose first plane is the luma
TURNS = {0: 0, 90: 1, 180: 2, -180: 2, -90: 3}  # display rotation in degrees → np.rot90's k


def say_what_it_is(path: Path, frame: Any) -> None:
    """A warning of each file whose pictures are not what others are."""
    said, hdr = "", _HDR.get(int(frame.color_trc))
    if frame.interlaced_frame:
        said = (
            "is interlaced: even and odd rows are of different moments, which shows as motion; film progressively, or "
            "deinterlace it"
        )
    elif hdr:
        said = (
            f"is HDR ({hdr}, {frame.format.components[0].bits} bits): values stay as they are coded; the curve only "
            "rises, so that motion is what it is, but colours look flat"
        )
    if said and path not in _SAID:
        _SAID.add(path)
        _LOG.warning(f"{path}: {said}")


def upright(frame: Any, pixels: np.ndarray) -> np.ndarray:
    """A decoded frame's pixels, turned as its container asks."""
    turns = TURNS.get(round(frame.rotation), 0)
    return np.ascontiguousarray(np.rot90(pixels, turns)) if turns else pixels


def luma(frame: Any) -> np.ndarray:
    """[H, W]: the first plane of planar formats, else converted; uint8, or float32, 0 to 255, of more than 8 bits."""
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
