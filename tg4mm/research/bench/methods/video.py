"""Two-dimensional magnification of each test view's video, without a scene or other views."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tg4mm.capture import Capture
from tg4mm.core.magnification import Magnification, apply_response, bins
from tg4mm.fit.magnify import SMALLEST, PhaseMagnifier, half_octave_bands
from tg4mm.research.bench.folder import files_state
from tg4mm.research.bench.methods import Pictures
from tg4mm.research.bench.request import BenchPlan
from tg4mm.research.bench.scored import cameras_of, video_of
from tg4mm.research.bench.sets import BenchSet, truth_at

# NTSC's luma and two chroma signals from RGB.
_YIQ = np.array([[0.299, 0.587, 0.114], [0.596, -0.274, -0.322], [0.211, -0.523, 0.312]])
_RGB = np.linalg.inv(_YIQ)
_VERSION = 2  # of these methods; to be raised when the same settings would give other pictures
_KERNEL = np.array([1, 4, 6, 4, 1], np.float32) / 16  # Burt and Adelson's binomial


class VideoMethod:
    """Base of both methods, which have no training, and a video for each camera of the test split."""

    name: str

    @property
    def rows(self) -> tuple[str, ...]:
        return (self.name,)

    def fit(self, data: BenchSet, place: Path, plan: BenchPlan) -> dict[str, Any]:
        return {}

    def recipe(self, row: str, data: BenchSet, place: Path, plan: BenchPlan) -> dict[str, Any]:
        own: dict[str, Any] = asdict(self)  # type: ignore[call-overload]
        seen = files_state(truth_at(data, 0).paths, data.root)
        return {"method": self.name, "version": _VERSION, **own, "band_hz": plan.band(data), "seen": seen}

    def render(
        self, row: str, data: BenchSet, place: Path, capture: Capture, alpha: float, plan: BenchPlan
    ) -> Pictures:
        seen = truth_at(data, 0)
        response = band_response(data, alpha, plan)
        for rows, own in zip(cameras_of(capture), cameras_of(seen), strict=True):
            video = video_of(seen, own)
            # magnified values may leave 0..1
            magnified = video if alpha == 0 else self.magnified(video, response, alpha).clip(0, 1)
            yield from zip(rows.tolist(), magnified, strict=True)

    def magnified(self, video: np.ndarray, response: np.ndarray, alpha: float) -> np.ndarray:
        """The video [T, H, W, 3]; response [T // 2 + 1]: α times the temporal filter's."""
        raise NotImplementedError


def band_response(data: BenchSet, alpha: float, plan: BenchPlan) -> np.ndarray:
    """Return [T // 2 + 1] complex: α times the zero-phase filter's response to the band, or α where there is none."""
    return Magnification.of(alpha, *plan.bands(data)).response(bins(data.n_timesteps, data.fps), data.fps)


@dataclass(frozen=True)
class Phase2D(VideoMethod):
    """Phase-based video motion processing [PVM].

    Complex sub-bands of half an octave and eight orientations; the phase since frame 0 is band-passed, smoothed with
    the amplitude as weight ([PVM] §3.4), and multiplied by α.

    Its authors' program magnifies luma alone; here chroma is magnified too, by its own phase, since otherwise coloured
    edges stay where they are, and the baseline is to be the best that 2D can do.
    """

    sigma: float = 2.0  # of the smoothing, cells of each sub-band
    chroma: bool = True
    name: str = "phase-2d"

    def magnified(self, video: np.ndarray, response: np.ndarray, alpha: float) -> np.ndarray:
        yiq = video @ _YIQ.T.astype(np.float32)
        height, width = _padded(yiq[:1, ..., 0]).shape[1:]
        magnify = SmoothedPhase((height, width), response, self.sigma)
        for c in range(3 if self.chroma else 1):
            yiq[..., c] = magnify(_padded(yiq[..., c]))[:, : video.shape[1], : video.shape[2]]
        return np.asarray(yiq @ _RGB.T.astype(np.float32))


class SmoothedPhase(PhaseMagnifier):
    """`PhaseMagnifier` with amplitude-weighted smoothing: φ ← (K ∗ Aφ) / (K ∗ A), K a Gaussian of `sigma` cells."""

    def __init__(self, shape: tuple[int, int], response: np.ndarray, sigma: float) -> None:
        super().__init__(shape, response, half_octave_bands(shape))
        self.sigma = sigma

    def turn(self, held: Tensor) -> None:
        from scipy.ndimage import gaussian_filter

        n = len(held)
        phase = torch.angle(held * held[:1].conj())
        phase = torch.fft.irfft(
            torch.fft.rfft(phase, dim=0) * self.response[: n // 2 + 1, None, None], n, dim=0
        )
        if self.sigma > 0:
            amplitude = held.abs().numpy() + np.float32(1e-8)
            width = (0, self.sigma, self.sigma)
            smooth = gaussian_filter(phase.numpy() * amplitude, width) / gaussian_filter(amplitude, width)
            phase = torch.from_numpy(smooth)
        held *= torch.polar(torch.ones_like(phase), phase) - 1


def _padded(video: np.ndarray) -> np.ndarray:
    """Repeat the last rows and columns of [T, H, W] up to even sizes for the sub-bands."""
    up = [max(SMALLEST, n + n % 2) - n for n in video.shape[1:]]
    return np.pad(video, ((0, 0), (0, up[0]), (0, up[1])), mode="edge")


@dataclass(frozen=True)
class Linear2D(VideoMethod):
    """Linear Eulerian video magnification (Wu et al. 2012).

    A Laplacian pyramid is band-passed over time. Each level is multiplied by α, but at most by what its wavelength λ
    allows: (1 + α) δ < λ/8, with δ such that λ_c just allows α.
    """

    cutoff: float = 16.0  # λ_c, pixels
    chroma: float = 0.1  # of α, for chroma
    name: str = "linear-2d"

    def magnified(self, video: np.ndarray, response: np.ndarray, alpha: float) -> np.ndarray:
        yiq = video @ _YIQ.T.astype(np.float32)
        levels = laplacian(yiq)
        response = response.copy()
        response[0] = 0.0  # the picture itself, which a windowed filter does not remove completely
        change = [np.zeros_like(level) for level in levels]
        for k in range(1, len(levels) - 1):  # neither the finest nor the rest, as published
            wavelength = float(np.hypot(video.shape[1], video.shape[2])) / 3 / 2 ** (len(levels) - 1 - k)
            allowed = wavelength / self.cutoff * (1 + abs(alpha)) - 1
            share = min(1.0, max(allowed, 0.0) / abs(alpha))
            if share > 0:
                change[k] = apply_response(levels[k], response) * np.float32(share)
        total = collapse(change)
        total[..., 1:] *= np.float32(self.chroma)
        return np.asarray((yiq + total) @ _RGB.T.astype(np.float32))


def laplacian(video: np.ndarray) -> list[np.ndarray]:
    """Return the levels of [T, H, W, C], finest first; the last, a low-pass, has fewer than ten cells a side."""
    levels, rest = [], video
    while min(rest.shape[1:3]) >= 10:
        low = _blurred(rest)[:, ::2, ::2]
        levels.append(rest - _enlarged(low, rest.shape[1:3]))
        rest = low
    return [*levels, rest]


def collapse(levels: list[np.ndarray]) -> np.ndarray:
    """Return the video of `laplacian`'s levels."""
    video = levels[-1]
    for level in reversed(levels[:-1]):
        video = level + _enlarged(video, level.shape[1:3])
    return video


def _blurred(video: np.ndarray) -> np.ndarray:
    from scipy.ndimage import convolve1d

    return convolve1d(convolve1d(video, _KERNEL, axis=1, mode="mirror"), _KERNEL, axis=2, mode="mirror")


def _enlarged(video: np.ndarray, size: tuple[int, ...]) -> np.ndarray:
    wide = np.zeros((len(video), *size, video.shape[-1]), video.dtype)
    wide[:, ::2, ::2] = video
    return np.asarray(_blurred(wide) * np.float32(4))
