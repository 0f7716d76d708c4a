"""A capture's pictures, in memory or on disk, as the motion stage reads them: a camera's distinct ones, by strips.

From disk, what one camera saw is decoded when its turn comes and let go after: T · H · W · 4 bytes, of which more than
256 MiB lie in a temporary file (`mapped_zeros`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from tg4mm.capture import Capture, ImageStack, load_images
from tg4mm.core.errors import CaptureError
from tg4mm.core.memory import mapped_zeros, release
from tg4mm.core.pictures.decode import THREADS, decode, image_header

# Bytes of pictures at 8 bits: more stay on disk. 300 timesteps of 512² in 30 views are 9 GiB
IN_MEMORY = 2 << 30
Strips = Callable[[slice], np.ndarray]  # rows of the picture → [S, rows, W, 4], as stored


class Pictures(Protocol):
    """C pictures of one size: RGBA with straight alpha, display-referred sRGB, 8 or 16 bits."""

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""

    @property
    def maximum(self) -> int:
        """The stored value that means 1."""

    def strips(self, rows: Sequence[int]) -> Strips:
        """Some pictures, to be asked for by rows."""


@dataclass(frozen=True)
class StackedPictures:
    """Pictures in memory."""

    images: ImageStack

    @property
    def size(self) -> tuple[int, int]:
        return self.images.data.shape[1], self.images.data.shape[2]

    @property
    def maximum(self) -> int:
        return self.images.maximum

    def strips(self, rows: Sequence[int]) -> Strips:
        indices = np.asarray(rows)
        return lambda strip: self.images.data[indices, strip]


@dataclass(frozen=True)
class FilePictures:
    """Pictures on disk, each decoded when it is asked for. Takes `ImageStack`'s place where only `rgb` and `alpha` are.

    Raises CaptureError for a file that is missing, truncated or damaged, or whose size has changed.
    """

    capture: Capture

    def __len__(self) -> int:
        return len(self.capture)

    @property
    def size(self) -> tuple[int, int]:
        return self.capture.height, self.capture.width

    @cached_property
    def maximum(self) -> int:
        """65535 if any file has 16 bits."""
        with ThreadPoolExecutor(THREADS) as pool:
            bits = max(header.bits for header in pool.map(image_header, self.capture.paths))
        return (1 << bits) - 1

    def strips(self, rows: Sequence[int]) -> Strips:
        data = mapped_zeros((len(rows), *self.size, 4), np.uint16 if self.maximum > 255 else np.uint8)

        def load(k: int) -> None:
            data[k] = self.stored(rows[k])
            release(data)

        with ThreadPoolExecutor(THREADS) as pool:
            for _ in pool.map(load, range(len(rows))):
                pass

        def strip(rows: slice) -> np.ndarray:
            out = np.array(data[:, rows])
            release(data)
            return out

        return strip

    def rgb(self, i: int) -> np.ndarray:
        """[H, W, 3] float32 in 0..1: picture i over white."""
        return over_white(self.stored(i)[None], self.maximum)[0]

    def alpha(self, i: int) -> np.ndarray:
        """[H, W] float32 coverage in 0..1 of picture i."""
        return self.stored(i)[..., 3] * np.float32(1 / self.maximum)

    def stored(self, i: int) -> np.ndarray:
        """[H, W, 4] uint8 or uint16: picture i."""
        path, (height, width) = self.capture.paths[i], self.size
        image = decode(path)
        if image.shape[:2] != (height, width):
            found = f"{image.shape[1]}×{image.shape[0]}"
            raise CaptureError(f"{path}: is {found} pixels, expected {width}×{height}")
        widen = self.maximum > 255 and image.dtype == np.uint8
        return image.astype(np.uint16) * 257 if widen else image


@dataclass(frozen=True)
class MaskedPictures:
    """One fixed camera's pictures; what is masked stays as it is in the first of them."""

    pictures: Pictures
    mask: np.ndarray  # [H, W] bool

    @property
    def size(self) -> tuple[int, int]:
        return self.pictures.size

    @property
    def maximum(self) -> int:
        return self.pictures.maximum

    @cached_property
    def _first(self) -> np.ndarray:
        return np.array(self.pictures.strips([0])(slice(None))[0])

    def strips(self, rows: Sequence[int]) -> Strips:
        raw = self.pictures.strips(rows)

        def strip(part: slice) -> np.ndarray:
            data, mask = np.array(raw(part)), self.mask[part]
            data[:, mask] = self._first[part][mask]
            return data

        return strip


def pictures_of(images: ImageStack | FilePictures) -> Pictures:
    """The same pictures, as the motion stage reads them."""
    return StackedPictures(images) if isinstance(images, ImageStack) else images


def over_white(raw: np.ndarray, maximum: int) -> np.ndarray:
    """[S, H, W, 3] float32 in 0..1 of pictures [S, H, W, 4] as stored, blended as `ImageStack.rgb` does."""
    scale = np.float32(1 / maximum)
    out = raw[..., :3] * scale
    alpha = raw[..., 3:]
    if alpha.min() < maximum:
        coverage = alpha * scale
        out *= coverage
        out += np.subtract(1, coverage, out=coverage)
    return out


def pictures_for(capture: Capture) -> ImageStack | FilePictures:
    """All pictures in memory, each decoded once; of long captures they stay on disk."""
    fit = len(capture) * capture.height * capture.width * 4 <= IN_MEMORY
    return load_images(capture) if fit else FilePictures(capture)
