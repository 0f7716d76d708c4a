"""The pixels of a capture, held once and compactly."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass

import numpy as np

from tg4mm.capture.model import Capture
from tg4mm.core.errors import CaptureError
from tg4mm.core.pictures.decode import THREADS, decode, image_header
from tg4mm.core.progress import Update, progress

WHITE = (1.0, 1.0, 1.0)
_SHOWN = 50_000_000  # pixels, which take some two seconds: reading more shows how far it is


@dataclass(frozen=True)
class ImageStack:
    """C images of one size, as stored: RGBA with straight alpha, display-referred sRGB."""

    data: np.ndarray  # [C, H, W, 4] uint8 or uint16

    def __post_init__(self) -> None:
        if self.data.ndim != 4 or self.data.shape[-1] != 4 or self.data.dtype not in (np.uint8, np.uint16):
            raise ValueError(
                f"data is {self.data.dtype} {self.data.shape}, expected uint8 or uint16 (C, H, W, 4)"
            )

    def __len__(self) -> int:
        """C, the number of images."""
        return len(self.data)

    @property
    def maximum(self) -> int:
        """The stored value that means 1."""
        return int(np.iinfo(self.data.dtype).max)

    def stored(self, i: int) -> np.ndarray:
        """[H, W, 4] uint8 or uint16: image i."""
        return self.data[i]

    def alpha(self, i: int) -> np.ndarray:
        """[H, W] float32 coverage in 0..1 of image i."""
        return self.data[i, ..., 3] * np.float32(1 / self.maximum)

    def rgb(self, i: int, background: tuple[float, float, float] = WHITE) -> np.ndarray:
        """[H, W, 3] float32 in 0..1: image i over the background, colour · alpha + background · (1 − alpha).

        Composited on display-referred values, as NeRF-synthetic's users do and as 3DGS's renderer blends.
        """
        alpha = self.alpha(i)[..., None]
        colour = self.data[i, ..., :3] * np.float32(1 / self.maximum)
        return colour * alpha + np.asarray(background, np.float32) * (1 - alpha)


def load_images(capture: Capture) -> ImageStack:
    """Decode every image of a capture, by threads.

    Args:
        capture: of any kind; all images stay in memory, 4 bytes a pixel (8 at 16 bits).

    Returns:
        C images, 16 bits for all if any file has them (8-bit values × 257).

    Raises:
        CaptureError: a file is missing, truncated or damaged, or its size has changed.
    """
    c, height, width = len(capture), capture.height, capture.width
    with ThreadPoolExecutor(THREADS) as pool:
        bits = max(header.bits for header in pool.map(image_header, capture.paths))
        try:
            data = np.empty((c, height, width, 4), np.uint16 if bits == 16 else np.uint8)
        except MemoryError:
            need = c * height * width * bits / 2 / 2**30
            raise CaptureError(
                f"{capture.root}: {c} pictures of {width}×{height} pixels need {need:.1f} GiB of memory"
            ) from None

        def load(i: int) -> None:
            image = decode(capture.paths[i])
            if image.shape[:2] != (height, width):
                size = f"{image.shape[1]}×{image.shape[0]}"
                raise CaptureError(f"{capture.paths[i]}: is {size} pixels, expected {width}×{height}")
            widen = data.dtype == np.uint16 and image.dtype == np.uint8
            data[i] = image.astype(np.uint16) * 257 if widen else image

        shown = progress("reading pictures", c, "pictures") if c * height * width > _SHOWN else nullcontext()
        with shown as update:
            _finish(pool, [pool.submit(load, i) for i in range(c)], update)
    return ImageStack(data)


def _finish(pool: ThreadPoolExecutor, futures: Iterable, update: Update | None = None) -> None:
    """Wait for all; on the first error, and on Ctrl-C, start no further ones."""
    try:
        for done, future in enumerate(futures, 1):
            future.result()
            if update:
                update(done)
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
