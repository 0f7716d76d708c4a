"""A capture's pictures, in memory or decoded on demand from disk, both read by strips, and windows on them.

Masks say which pixels count (white), and where a person says that motion may be. A window is a
part of the pictures, in which squares of pixels are averaged to one.

From disk, what one camera saw is decoded when its turn comes and let go when another's does: T · H · W · 4 bytes, of
which more than 256 MiB lie in a temporary file (`mapped_zeros`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np
from PIL import Image, ImageDraw

from tg4mm.capture.frames import each_picture, frame_of, picture, picture_header
from tg4mm.capture.model import Capture
from tg4mm.capture.planes import LUMA
from tg4mm.core.errors import CaptureError
from tg4mm.core.memory import mapped_zeros, release
from tg4mm.core.pictures.decode import THREADS, decode
from tg4mm.core.progress import progress

WHITE = (1.0, 1.0, 1.0)
_SHOWN = 50_000_000  # pixels, which take some two seconds: reading more shows how far it is
# Bytes of pictures at 8 bits: more stay on disk. 300 timesteps of 512² in 30 views are 9 GiB
IN_MEMORY = 1 << 30


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
    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.data.shape[1], self.data.shape[2]

    @property
    def maximum(self) -> int:
        """The stored value that means 1."""
        return int(np.iinfo(self.data.dtype).max)

    def strips(self, rows: Sequence[int]) -> Strips:
        """Return some pictures as a function of rows."""
        indices = np.asarray(rows)
        return lambda strip: self.data[indices, strip]

    def stored(self, i: int) -> np.ndarray:
        """Return [H, W, 4] uint8 or uint16: image i."""
        return self.data[i]

    def through(self, window: Window) -> ImageStack:
        """The images as a window shows them."""
        return ImageStack(np.stack([window.averaged(image) for image in self.data]))

    def alpha(self, i: int) -> np.ndarray:
        """Return [H, W] float32 coverage in 0..1 of image i."""
        return self.data[i, ..., 3] * np.float32(1 / self.maximum)

    def rgb(self, i: int, background: tuple[float, float, float] = WHITE) -> np.ndarray:
        """Return [H, W, 3] float32 in 0..1: image i over the background, colour · alpha + background · (1 − alpha).

        Composited on display-referred values, as NeRF-synthetic's users do and as 3DGS's renderer blends.
        """
        if background == WHITE:
            return over_white(self.data[i], self.maximum)
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
    bits = _bits(capture)
    try:
        data = np.empty((c, height, width, 4), np.uint16 if bits == 16 else np.uint8)
    except MemoryError:
        need = c * height * width * bits / 2 / 2**30
        raise CaptureError(
            f"{capture.root}: {c} pictures of {width}×{height} pixels need {need:.1f} GiB of memory"
        ) from None

    def take(i: int, image: np.ndarray) -> None:
        data[i] = _widened(_sized(capture.paths[i], capture.pinhole(i, image), (height, width)), bits)

    shown = progress("reading pictures", c, "pictures") if c * height * width > _SHOWN else nullcontext()
    with shown as update:
        for done in each_picture(capture.paths, take):
            if update:
                update(done)
    return ImageStack(data)


def _bits(capture: Capture) -> int:
    """Return the bits of each channel: 16 if any file has them."""
    with ThreadPoolExecutor(THREADS) as pool:
        return max(header.bits for header in pool.map(picture_header, capture.paths))


def _sized(path: Path, image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """A decoded picture, which must have that size (height, width)."""
    if image.shape[:2] != size:
        raise CaptureError(
            f"{path}: is {image.shape[1]}×{image.shape[0]} pixels, expected {size[1]}×{size[0]}"
        )
    return image


def _widened(image: np.ndarray, bits: int) -> np.ndarray:
    return image.astype(np.uint16) * 257 if bits == 16 and image.dtype == np.uint8 else image


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
        """Return some pictures as a function of rows."""


@dataclass(frozen=True)
class FilePictures:
    """Pictures on disk, each decoded when it is asked for. Takes `ImageStack`'s place where only `rgb` and `alpha` are.

    Raises CaptureError for a file that is missing, truncated or damaged, or whose size has changed.
    """

    capture: Capture
    window: Window | None = None
    # the most pictures that were asked for
    _decoded: dict[tuple[int, ...], np.ndarray] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.capture)

    @property
    def size(self) -> tuple[int, int]:
        whole = self.capture.height, self.capture.width
        return whole if self.window is None else self.window.size

    @cached_property
    def maximum(self) -> int:
        """65535 if any file has 16 bits, and where the window averages."""
        averages = self.window is not None and self.window.factor > 1
        return (1 << (16 if averages else _bits(self.capture))) - 1

    def through(self, window: Window) -> FilePictures:
        """The pictures as a window shows them."""
        return FilePictures(self.capture, window)

    def strips(self, rows: Sequence[int]) -> Strips:
        asked = tuple(int(row) for row in rows)
        data = self._decoded.get(asked)
        if data is None:
            data = self._decode(asked)
            if len(asked) >= max(map(len, self._decoded), default=0):
                self._decoded.clear()
                self._decoded[asked] = data

        def strip(rows: slice) -> np.ndarray:
            out = np.array(data[:, rows])
            release(data)
            return out

        return strip

    def _decode(self, rows: Sequence[int]) -> np.ndarray:
        data = mapped_zeros((len(rows), *self.size, 4), np.uint16 if self.maximum > 255 else np.uint8)

        def take(k: int, image: np.ndarray) -> None:
            data[k] = self._stored(rows[k], image)
            release(data)

        for _ in each_picture([self.capture.paths[row] for row in rows], take):
            pass
        return data

    def rgb(self, i: int) -> np.ndarray:
        """Return [H, W, 3] float32 in 0..1: picture i over white."""
        return over_white(self.stored(i), self.maximum)

    def alpha(self, i: int) -> np.ndarray:
        """Return [H, W] float32 coverage in 0..1 of picture i."""
        return self.stored(i)[..., 3] * np.float32(1 / self.maximum)

    def stored(self, i: int) -> np.ndarray:
        """Return [H, W, 4] uint8 or uint16: picture i."""
        return self._stored(i, picture(self.capture.paths[i]))

    def _stored(self, i: int, image: np.ndarray) -> np.ndarray:
        whole = self.capture.height, self.capture.width
        own = _sized(self.capture.paths[i], self.capture.pinhole(i, image), whole)
        if self.window is not None:
            own = self.window.averaged(own)
        return _widened(own, self.maximum.bit_length())


@dataclass(frozen=True)
class MaskedPictures:
    """Pictures of fixed cameras, whose masked pixels stay as in each camera's first picture."""

    pictures: Pictures
    masks: np.ndarray  # [V, H, W] bool
    of_row: Mapping[int, int]  # which of the V cameras took a picture
    first: tuple[int, ...]  # V pictures

    @property
    def size(self) -> tuple[int, int]:
        return self.pictures.size

    @property
    def maximum(self) -> int:
        return self.pictures.maximum

    def strips(self, rows: Sequence[int]) -> Strips:
        raw = self.pictures.strips(rows)
        cameras = [self.of_row.get(int(row)) for row in rows]
        held = {v: self.pictures.strips([self.first[v]]) for v in cameras if v is not None}

        def strip(part: slice) -> np.ndarray:
            data, still = np.array(raw(part)), {v: own(part)[0] for v, own in held.items()}
            for k, v in enumerate(cameras):
                if v is not None:
                    mask = self.masks[v, part]
                    data[k][mask] = still[v][mask]
            return data

        return strip


def over_white(raw: np.ndarray, maximum: int) -> np.ndarray:
    """Return [..., H, W, 3] float32 in 0..1 of pictures [..., H, W, 4] as stored, blended as `ImageStack.rgb` does."""
    scale = np.float32(1 / maximum)
    out = np.empty((*raw.shape[:-1], 3), np.float32)
    for channel in range(3):  # less than half the time of all at once
        np.multiply(raw[..., channel], scale, out=out[..., channel])
    alpha = raw[..., 3:]
    if alpha.min() < maximum:
        coverage = alpha * scale
        out *= coverage
        out += np.subtract(1, coverage, out=coverage)
    return out


def grey_over_white(raw: np.ndarray, maximum: int) -> np.ndarray:
    """Return [..., H, W] float32 grey levels, 0 to 255, of pictures [..., H, W, 4] as stored."""
    is_opaque = raw[..., 3].min() == maximum
    # then without a copy of the colours, in a sixth of the time
    shown = np.multiply(raw, np.float32(1 / maximum))[..., :3] if is_opaque else over_white(raw, maximum)
    return np.asarray(255 * (shown @ LUMA))


_Shelf = dict[tuple[object, ...] | None, ImageStack]
_shelf: ContextVar[_Shelf | None] = ContextVar("shelf", default=None)


@contextmanager
def read_once() -> Iterator[None]:
    """Let `pictures_for` and `some_pictures` share the last capture's pictures, for steps that follow one another."""
    token = _shelf.set({})
    try:
        yield
    finally:
        _shelf.reset(token)


def _place(capture: Capture) -> tuple[object, ...] | None:
    """Return what determines a capture's pixels, with the state of its files; None where that is more than these."""
    if any(capture.lenses):
        return None
    files = {path if frame is None else frame[0] for path in capture.paths for frame in [frame_of(path)]}
    states = [(str(f), f.stat().st_size, f.stat().st_mtime_ns) for f in sorted(files)]
    return *states, *map(str, capture.paths), capture.width, capture.height


def pictures_for(capture: Capture) -> ImageStack | FilePictures:
    """All pictures in memory, each decoded once; of long captures they stay on disk."""
    if len(capture) * capture.height * capture.width * 4 > IN_MEMORY:
        return FilePictures(capture)
    shelf, place = _shelf.get(), _place(capture)
    if shelf is None or place is None:
        return load_images(capture)
    if place not in shelf:
        shelf.clear()
        shelf[place] = load_images(capture)
    return shelf[place]


def some_pictures(capture: Capture, rows: np.ndarray) -> ImageStack:
    """Some pictures of a capture, in memory."""
    kept = (_shelf.get() or {}).get(_place(capture))
    return load_images(capture.selected(rows)) if kept is None else ImageStack(kept.data[rows])


def mask_of(capture: Capture, i: int) -> np.ndarray | None:
    """Return [H, W] bool of picture i, true where it counts; None where it has no mask.

    Raises CaptureError for a mask of another size than its picture, and for one that leaves nothing.
    """
    path = capture.masks[i] if capture.masks else None
    if path is None:
        return None
    lens = capture.lenses[i] if capture.lenses else None
    size = (capture.width, capture.height)
    own = (lens.taken_of or size) if lens is not None else size
    white = _read(path, own)
    if lens is not None:
        shown = np.repeat(np.where(white, 255, 0).astype(np.uint8)[..., None], 3, axis=2)
        white = lens.apply(shown)[..., 0] > 254  # what is ignored in part is ignored
    return white


def _read(path: Path, size: tuple[int, int]) -> np.ndarray:
    """Return [H, W] bool of a mask for a picture of (width, height)."""
    state = path.stat()
    return _read_once(path, size, state.st_size, state.st_mtime_ns)


@lru_cache(64)
def _read_once(path: Path, size: tuple[int, int], length: int, changed_ns: int) -> np.ndarray:
    image = decode(path)
    if image.shape[1::-1] != size:
        raise CaptureError(
            f"{path}: the mask is {image.shape[1]}×{image.shape[0]} pixels, its picture {size[0]}×{size[1]}"
        )
    white = (image[..., :3].max(2) > 0) & (image[..., 3] > 0)
    return _not_empty(white, str(path))


def _not_empty(white: np.ndarray, name: str) -> np.ndarray:
    if not white.any():
        raise CaptureError(f"{name}: the mask is empty: no pixel of the picture is left")
    return white


def region_mask(text: str, size: tuple[int, int]) -> np.ndarray:
    """Return [H, W] bool of "X,Y X,Y X,Y …", a polygon in pixels, or of a PNG's path, for pictures of (width, height).

    Raises CaptureError for a polygon of fewer than three corners, one with no pixel in it, a mask of another size, and
    for a file that is not there.
    """
    corners = _corners(text)
    if corners is None:
        path = Path(text)
        if not path.is_file():
            raise CaptureError(f"{text!r} is neither a mask's file nor a polygon, X,Y X,Y X,Y in pixels")
        return _read(path, size)
    if len(corners) < 3:
        raise CaptureError(f"{text!r} has {len(corners)} corners, a polygon has three or more")
    image = Image.new("1", size)
    ImageDraw.Draw(image).polygon([(x - 0.5, y - 0.5) for x, y in corners], fill=1)
    return _not_empty(np.array(image, bool), repr(text))


def _corners(text: str) -> list[tuple[float, float]] | None:
    """Return the corners; None if the text is no list of pairs of numbers."""
    try:
        pairs = [tuple(float(n) for n in part.split(",")) for part in text.split()]
    except ValueError:
        return None
    if not pairs or any(len(p) != 2 or not np.isfinite(p).all() for p in pairs):
        return None
    return [(p[0], p[1]) for p in pairs]


@dataclass(frozen=True)
class Window:
    """Rows and columns of a picture, whole numbers of squares of `factor` pixels."""

    top: int
    left: int
    rows: int  # of the window's own pixels
    columns: int
    factor: int

    @staticmethod
    def on(
        height: int, width: int, factor: int = 1, wanted: np.ndarray | None = None, margin: int = 0
    ) -> Window:
        """Return the window with the pixels `wanted` [H, W] bool and `margin` pixels around, or with the whole picture.

        Incomplete squares are cut off.
        """
        rows, columns = slice(0, height), slice(0, width)
        if wanted is not None:
            rows, columns = (_reach(wanted.any(axis), margin) for axis in (1, 0))
        n_rows, n_columns = (max((s.stop - s.start) // factor, 1) for s in (rows, columns))
        return Window(rows.start, columns.start, n_rows, n_columns, factor)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in its own pixels."""
        return self.rows, self.columns

    def K(self, K: np.ndarray) -> np.ndarray:
        """Return [..., 3, 3]: intrinsics in its own pixels."""
        out = K.copy()
        out[..., :2, 2] -= np.array([self.left, self.top], K.dtype)
        out[..., :2, :] /= self.factor
        return out

    def part(self, image: np.ndarray) -> np.ndarray:
        """Return [rows · factor, columns · factor, …] of an image [H, W, …], as it is."""
        height, width = self.rows * self.factor, self.columns * self.factor
        return image[self.top : self.top + height, self.left : self.left + width]

    def all_of(self, mask: np.ndarray) -> np.ndarray:
        """Return [rows, columns] bool: where every pixel of a square is in the mask [H, W]."""
        return self._squares(self.part(mask)).all((1, 3))

    def any_of(self, mask: np.ndarray) -> np.ndarray:
        """Return [rows, columns] bool: where a pixel of a square is in the mask [H, W]."""
        return self._squares(self.part(mask)).any((1, 3))

    def averaged(self, image: np.ndarray) -> np.ndarray:
        """Return [rows, columns, 4] of a stored RGBA image [H, W, 4]; of squares of several pixels uint16, 65535 is 1.

        Colours count by their alpha, as straight alpha has it.
        """
        part = self.part(image)
        if self.factor == 1:
            return part
        scale = 257 if image.dtype == np.uint8 else 1
        alpha = part[..., 3]
        if alpha.min() == np.iinfo(image.dtype).max:
            total = self._sum(part)
            return ((total * scale + self.factor**2 // 2) // self.factor**2).astype(np.uint16)
        coverage = self._sum(alpha[..., None]).astype(np.float64)
        colour = self._sum(part[..., :3].astype(np.uint64) * alpha[..., None])
        out = np.concatenate([colour / np.maximum(coverage, 1), coverage / self.factor**2], axis=-1)
        return np.rint(out * scale).astype(np.uint16)

    def _sum(self, part: np.ndarray) -> np.ndarray:
        """Return [rows, columns, C] uint32 or uint64: sums over squares, first of rows, whose pixels lie together."""
        kind, k = (np.uint64 if part.dtype == np.uint64 else np.uint32), self.factor
        down: np.ndarray = part[::k].astype(kind)
        for i in range(1, k):
            down += part[i::k]
        out = down[:, ::k].copy()
        for j in range(1, k):
            out += down[:, j::k]
        return out

    def _squares(self, part: np.ndarray) -> np.ndarray:
        return part.reshape(self.rows, self.factor, self.columns, self.factor)


def _reach(some: np.ndarray, margin: int) -> slice:
    where = np.flatnonzero(some)
    if not len(where):
        return slice(0, len(some))
    return slice(max(int(where[0]) - margin, 0), min(int(where[-1]) + 1 + margin, len(some)))
