"""Films of moving layers with exact truth: layers of band-limited texture, light, a sensor's noise, a codec.

A layer is a texture under a soft mask, made at three times the resolution. Its displacement u(x, y, t) of up to .6 px
is a Taylor series of sixth order with spectral derivatives: there is no interpolation kernel, and u is exact to a
thousandth of itself. u: pixels to the right and down.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import factorial
from pathlib import Path

import numpy as np

FINE = 3  # fine pixels a pixel
ORDER = 6
_MARGIN = 8  # pixels beside a mask that a layer reaches into
Motion = Callable[[float], float]  # of time in seconds
Region = tuple[int, int, int, int]  # left, upper, right, lower edge, pixels


@dataclass(frozen=True)
class Mode:
    """A displacement shape [H, W, 2] in pixels times a function of time."""

    shape: np.ndarray
    motion: Motion


class Layer:
    """A texture over a region, moved by modes."""

    def __init__(
        self, texture: np.ndarray, region: Region | None, modes: Sequence[Mode], blur_px: float
    ) -> None:
        """texture [3 H, 3 W], linear light; region None: the whole picture; blur_px: the lens."""
        height, width = (n // FINE for n in texture.shape)
        left, upper, right, lower = region or (-_MARGIN, -_MARGIN, width + _MARGIN, height + _MARGIN)
        mask = np.zeros((height * FINE, width * FINE))
        mask[max(upper, 0) * FINE : lower * FINE, max(left, 0) * FINE : right * FINE] = 1
        self.box = (
            slice(max(upper - _MARGIN, 0), min(lower + _MARGIN, height)),
            slice(max(left - _MARGIN, 0), min(right + _MARGIN, width)),
        )
        fine = tuple(slice(s.start * FINE, s.stop * FINE) for s in self.box)
        self._covered = [texture[fine] * mask[fine], mask[fine]]  # light, then opacity
        self._blur, self.modes = blur_px, list(modes)
        self._terms: list[tuple[int, int, np.ndarray]] | None = None
        self.rest = np.stack([_down(self._derivative(a, 0, 0)) for a in self._covered])

    def _derivative(self, picture: np.ndarray, across: int, along: int) -> np.ndarray:
        """Of a blurred fine picture, in pixels."""
        pad = _MARGIN * FINE
        padded = np.pad(picture, pad, mode="edge")
        ky = 2 * np.pi * FINE * np.fft.fftfreq(padded.shape[0])[:, None]
        kx = 2 * np.pi * FINE * np.fft.rfftfreq(padded.shape[1])[None]
        factor = (1j * kx) ** across * (1j * ky) ** along * np.exp(-0.5 * self._blur**2 * (kx**2 + ky**2))
        return np.fft.irfft2(np.fft.rfft2(padded) * factor, s=padded.shape)[pad:-pad, pad:-pad]

    def _series(self) -> list[tuple[int, int, np.ndarray]]:
        terms = []
        for n in range(ORDER + 1):
            for i in range(n + 1):
                weight = (-1) ** n / (factorial(i) * factorial(n - i))
                fields = [_down(self._derivative(a, i, n - i)) * weight for a in self._covered]
                terms.append((i, n - i, np.stack(fields).astype(np.float32)))
        return terms

    def drawn(self, time_s: float, sway: np.ndarray) -> np.ndarray:
        """[2, h, w]: light times opacity, and opacity, moved; sway [2]: the camera's own."""
        if not self.modes and not sway.any():
            return self.rest
        if self._terms is None:
            self._terms = self._series()
        moved = np.broadcast_to(sway.astype(np.float32), (*self.rest.shape[1:], 2)).copy()
        for mode in self.modes:
            moved += (mode.shape[self.box] * mode.motion(time_s)).astype(np.float32)
        powers = [[moved[..., k] ** n for n in range(ORDER + 1)] for k in (0, 1)]
        return sum(
            (powers[0][i] * powers[1][j] * field for i, j, field in self._terms),
            np.zeros_like(self._terms[0][2]),
        )


def _down(fine: np.ndarray) -> np.ndarray:
    h, w = (n // FINE for n in fine.shape)
    return np.asarray(fine.reshape(h, FINE, w, FINE).mean((1, 3)))


def texture(
    height: int, width: int, rng: np.random.Generator, contrast: float, mean: float, sizes_px: Sequence[float]
) -> np.ndarray:
    """[3 H, 3 W] linear light: noise smoothed by Gaussians of several sizes, periodic."""
    ky = np.fft.fftfreq(height * FINE)[:, None] * FINE
    kx = np.fft.rfftfreq(width * FINE)[None] * FINE
    total = np.zeros((height * FINE, width * FINE))
    for size in sizes_px:
        white = np.fft.rfft2(rng.normal(size=total.shape))
        smooth = np.fft.irfft2(white * np.exp(-2 * (np.pi * size) ** 2 * (kx**2 + ky**2)), s=total.shape)
        total += smooth / smooth.std()
    return np.clip(mean * (1 + contrast / len(sizes_px) ** 0.5 * total), 0.01, 0.95)


@dataclass(frozen=True)
class Coding:
    """How a film is stored."""

    codec: str  # libx264, libx265
    bits_per_second: int
    keys_every: int | None = None  # pictures


Painter = Callable[[np.ndarray, float, int], np.ndarray]  # picture, time, number → picture


@dataclass(frozen=True)
class Film:
    """Layers from back to front, what is painted over them, light, noise."""

    layers: Sequence[Layer]
    fps: int
    frames: int
    noise: float  # standard deviation, grey levels of 255
    light: Motion = lambda t: 1.0
    sway: Callable[[float], np.ndarray] = lambda t: np.zeros(2)
    painters: Sequence[Painter] = ()
    seed: int = 0

    def pictures(self) -> np.ndarray:
        """[F, H, W] uint8."""
        rng = np.random.default_rng(self.seed)
        shape = self.layers[0].rest.shape[1:]
        out = np.empty((self.frames, *shape), np.uint8)
        for k in range(self.frames):
            t = k / self.fps
            picture, sway = np.zeros(shape, np.float32), self.sway(t)
            for layer in self.layers:
                light, opacity = layer.drawn(t, sway)
                picture[layer.box] = light + picture[layer.box] * (1 - np.clip(opacity, 0, 1))
            for paint in self.painters:
                picture = paint(picture, t, k)
            picture = picture * self.light(t)
            shown = 255 * _display(picture)
            # photons: their noise after the display curve depends little on the light
            noise = self.noise * (0.7 + 0.6 * np.sqrt(np.clip(picture, 0, 1)))
            shown = shown + noise * rng.standard_normal(shape, np.float32)
            out[k] = np.clip(np.round(shown), 0, 255)
        return out


def _display(light: np.ndarray) -> np.ndarray:
    """sRGB's curve."""
    x = np.clip(light, 0, 1)
    return np.where(x < 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def write_video(path: Path, pictures: np.ndarray, fps: int, coding: Coding) -> None:
    """Code grey pictures [F, H, W] uint8; what is there under another name until the file is whole."""
    import av

    unfinished = path.with_suffix(".part.mp4")
    limits = {"maxrate": str(coding.bits_per_second), "bufsize": str(coding.bits_per_second)}
    options = {"preset": "medium", "threads": "1", **limits}
    if coding.codec == "libx265":
        rate = coding.bits_per_second // 1000
        options["x265-params"] = (
            f"log-level=error:pools=none:frame-threads=1:vbv-maxrate={rate}:vbv-bufsize={rate}"
        )
    if coding.keys_every:
        options["g"] = str(coding.keys_every)
    with av.open(str(unfinished), "w") as container:
        stream = container.add_stream(coding.codec, rate=Fraction(fps), options=options)
        stream.width, stream.height, stream.pix_fmt = pictures.shape[2], pictures.shape[1], "yuv420p"
        stream.bit_rate = coding.bits_per_second
        for picture in pictures:
            frame = av.VideoFrame.from_ndarray(picture, format="gray")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    unfinished.replace(path)
