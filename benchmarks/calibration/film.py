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
from typing import Any

import numpy as np
from scipy import ndimage

FINE = 3  # fine pixels a pixel
ORDER = 6
_LENS_PX = 0.55  # blur of a surface that slides
_TICK = Fraction(1, 90_000)  # seconds, of time stamps
_HLG = (9, 18, 9, 1)  # primaries of BT.2020, curve, matrix, limited range, as FFmpeg numbers them
_MARGIN = 8  # pixels beside a mask that a layer reaches into
Motion = Callable[[float], float]  # of time in seconds
Region = tuple[int, int, int, int]  # left, upper, right, lower edge, pixels


@dataclass(frozen=True)
class FilmMode:
    """A displacement shape [H, W, 2] in pixels times a function of time."""

    shape: np.ndarray
    motion: Motion


class Layer:
    """A texture over a region, moved by modes."""

    def __init__(
        self, texture: np.ndarray, region: Region | None, modes: Sequence[FilmMode], blur_px: float
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
        self.rest = np.stack([area_means(self._derivative(a, 0, 0)) for a in self._covered])

    def _derivative(self, picture: np.ndarray, across: int, along: int) -> np.ndarray:
        """Return the derivative of a blurred fine picture, in pixels."""
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
                fields = [area_means(self._derivative(a, i, n - i)) * weight for a in self._covered]
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


def area_means(fine: np.ndarray, by: int = FINE) -> np.ndarray:
    """Means of squares of `by` fine pixels."""
    h, w = (n // by for n in fine.shape)
    return np.asarray(fine.reshape(h, by, w, by).mean((1, 3)))


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
    """Settings by which a film is encoded."""

    codec: str  # libx264, libx265
    bits_per_second: int
    keys_every: int | None = None  # pictures
    turn: int = 0  # degrees by which players turn it, anticlockwise
    crf: int | None = None  # constant quality, 0 without loss (x264); None: by the rate
    preset: str = "medium"


Painter = Callable[[np.ndarray, float, int], np.ndarray]  # picture, time, number → picture


def sliding(surface: np.ndarray, centre: tuple[int, int], motion: Callable[[float], np.ndarray]) -> Painter:
    """A window in which a surface [3 h, 3 w], periodic, slides by any distance, exactly.

    motion: pixels right and down at a time. The window is smaller than the surface by 16 pixels on each side.
    """
    spectrum = np.fft.rfft2(ndimage.gaussian_filter(surface, _LENS_PX * FINE, mode="wrap"))
    h, w = (n // FINE for n in surface.shape)
    down, right = np.fft.fftfreq(h * FINE)[:, None], np.fft.rfftfreq(w * FINE)[None]
    window = ndimage.gaussian_filter(np.pad(np.ones((h - 32, w - 32)), 16), 1.0)
    left, upper = centre[0] - w // 2, centre[1] - h // 2
    box = slice(upper, upper + h), slice(left, left + w)

    def paint(picture: np.ndarray, time_s: float, number: int) -> np.ndarray:
        x, y = FINE * motion(time_s)
        moved = np.fft.irfft2(spectrum * np.exp(-2j * np.pi * (right * x + down * y)), surface.shape)
        picture[box] += window * (area_means(moved) - picture[box])
        return picture

    return paint


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
    times_s: Sequence[float] | None = None  # of the frames, where they are not k / fps
    is_hlg: bool = False  # of 10 bits, with the curve of HLG (ITU-R BT.2100)

    def pictures(self) -> np.ndarray:
        """[F, H, W] uint8; uint16, 64 to 940, of 10 bits."""
        rng = np.random.default_rng(self.seed)
        shape = self.layers[0].rest.shape[1:]
        out = np.empty((self.frames, *shape), np.uint16 if self.is_hlg else np.uint8)
        for k in range(self.frames):
            t = k / self.fps if self.times_s is None else self.times_s[k]
            picture, sway = np.zeros(shape, np.float32), self.sway(t)
            for layer in self.layers:
                light, opacity = layer.drawn(t, sway)
                picture[layer.box] = light + picture[layer.box] * (1 - np.clip(opacity, 0, 1))
            for paint in self.painters:
                picture = paint(picture, t, k)
            picture = picture * self.light(t)
            shown = 255 * (_hlg if self.is_hlg else _display)(picture)
            # photons: their noise after the display curve depends little on the light
            noise = self.noise * (0.7 + 0.6 * np.sqrt(np.clip(picture, 0, 1)))
            shown = shown + noise * rng.standard_normal(shape, np.float32)
            out[k] = np.clip(
                np.round(64 + 876 / 255 * shown if self.is_hlg else shown), 0, 1023 if self.is_hlg else 255
            )
        return out


def _display(light: np.ndarray) -> np.ndarray:
    """sRGB's curve."""
    x = np.clip(light, 0, 1)
    return np.where(x < 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def _hlg(light: np.ndarray) -> np.ndarray:
    """HLG's curve (ITU-R BT.2100, table 5)."""
    x = np.clip(light, 0, 1)
    upper = 0.17883277 * np.log(np.maximum(12 * x - 0.28466892, 1e-9)) + 0.55991073
    return np.where(x < 1 / 12, np.sqrt(3 * x), upper)


def write_video(
    path: Path, pictures: np.ndarray, fps: int, coding: Coding, times_s: Sequence[float] | None = None
) -> None:
    """Code pictures: grey [F, H, W] uint8, sRGB [F, H, W, 3], or HLG uint16 of 10 bits with the primaries of BT.2020.

    times_s: of the frames, in place of k / fps. What is there has another name until the file is whole.
    """
    import av

    unfinished = path.with_suffix(".part.mp4")
    limits = {"maxrate": str(coding.bits_per_second), "bufsize": str(coding.bits_per_second)}
    options = {"preset": coding.preset, "threads": "1"}
    options |= limits if coding.crf is None else {"crf": str(coding.crf)} if coding.crf else {"qp": "0"}
    if coding.codec == "libx265":
        rate = coding.bits_per_second // 1000
        options["x265-params"] = "log-level=error:pools=none:frame-threads=1"
        if coding.crf is None:
            options["x265-params"] += f":vbv-maxrate={rate}:vbv-bufsize={rate}"
    if coding.keys_every:
        options["g"] = str(coding.keys_every)
    with av.open(str(unfinished), "w") as container:
        stream = container.add_stream(coding.codec, rate=Fraction(fps), options=options)
        stream.width, stream.height, stream.pix_fmt = pictures.shape[2], pictures.shape[1], "yuv420p"
        if coding.bits_per_second:
            stream.bit_rate = coding.bits_per_second
        if pictures.dtype == np.uint16:
            stream.pix_fmt, context = "yuv420p10le", stream.codec_context
            context.color_primaries, context.color_trc, context.colorspace, context.color_range = _HLG
        if coding.turn:
            stream.set_display_rotation(coding.turn)
        if times_s is not None:
            stream.time_base = stream.codec_context.time_base = _TICK
        for k, picture in enumerate(pictures):
            frame = _frame(picture)
            if times_s is not None:
                frame.pts, frame.time_base = round((times_s[k] - times_s[0]) / _TICK), _TICK
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    unfinished.replace(path)


def _frame(picture: np.ndarray) -> Any:
    import av

    if picture.dtype != np.uint16:
        return av.VideoFrame.from_ndarray(picture, format="rgb24" if picture.ndim == 3 else "gray")
    grey = np.full((len(picture) // 2, picture.shape[1]), 512, np.uint16)
    frame = av.VideoFrame.from_ndarray(np.concatenate([picture, grey]), format="yuv420p10le")
    frame.color_primaries, frame.color_trc, frame.colorspace, frame.color_range = _HLG
    return frame
