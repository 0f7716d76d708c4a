"""A known motion through the encoder that made a video, and what is left of it."""

import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter

from tg4mm.capture.codec.probe import Probe, rate_options
from tg4mm.capture.video import BETWEEN, av_module, file_url

_NOISE_PX = 8.0  # over which the key frames' noise is averaged
_AROUND_PX = 12  # about a region, that moves with it in the test: a codec decides by blocks of 16 pixels
_EDGE_PX = 2.0  # over which that motion fades
_UNEVEN = 0.01  # of a frame


@dataclass(frozen=True)
class Tone:
    """A measured vibration of one region."""

    frequency_hz: float  # of the pictures' clock
    phasor: np.ndarray  # [2] complex, pixels right and down, zero to peak


def through(
    made: Probe,
    masks: Sequence[np.ndarray],
    tones: Sequence[Sequence[Tone]],
    times: np.ndarray,
    seed: int,
    without_between: bool,
) -> list[list[tuple[float, float]]]:
    """Gain and its standard error of each region's tones, after one encoding."""
    most = 255 if made.pixels == "yuv420p" else 1023
    rng, is_new = np.random.default_rng(seed), np.diff(times, prepend=-1) > 0
    mean, height = made.planes.mean(0, dtype=np.float32), made.luma.shape[1]
    down, right = np.gradient(mean[:height])
    noise = _noise(made, mean)
    moves = [np.stack([_series(own, times, axis) for axis in (0, 1)], 1) for own in tones]
    soft = [gaussian_filter(mask, _EDGE_PX) for mask in _grown(masks)]

    def pictures() -> Iterator[np.ndarray]:
        for k in range(len(times)):
            if is_new[k]:
                shown = mean + noise * rng.standard_normal(mean.shape, dtype=np.float32)
                for u, mask in zip(moves, soft, strict=True):
                    shown[:height] -= mask * (u[k, 0] * right + u[k, 1] * down)
            yield np.clip(np.rint(shown), 0, most).astype(made.planes.dtype)

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "test.mkv"
        _encode(path, made, pictures())
        seen, is_between = _decoded(path)
    used = is_new & ~is_between if without_between else is_new
    return [
        [gain_of(u, own, j, times[used]) for j in range(len(own))]
        for own, u in ((own, shifts_of(seen[used], mask)) for own, mask in zip(tones, masks, strict=True))
    ]


def _grown(masks: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The regions with what is around them and in no other."""
    wide = [maximum_filter(mask, 2 * _AROUND_PX + 1) for mask in masks]
    every = np.max(masks, axis=0)
    return [np.where(every > 0, mask, own).astype(np.float32) for mask, own in zip(masks, wide, strict=True)]


def _noise(made: Probe, mean: np.ndarray) -> np.ndarray:
    """[3 H / 2, W]: standard deviation of the key frames about the mean, smoothed, brightness and colours apart."""
    n, height = len(made.planes), made.luma.shape[1]
    keys = made.planes[made.is_key] if made.is_key.any() else made.planes[:1]
    variance = (np.mean([(key - mean) ** 2 for key in keys], axis=0) * n / max(n - 1, 1)).astype(np.float32)
    parts = variance[:height], variance[height:]
    return np.sqrt(np.concatenate([gaussian_filter(part, _NOISE_PX) for part in parts]))


def _series(tones: Sequence[Tone], times: np.ndarray, axis: int) -> np.ndarray:
    """[F] pixels."""
    waves = [(t.phasor[axis] * np.exp(2j * np.pi * t.frequency_hz * times)).real for t in tones]
    return np.sum(waves, axis=0)


def _encode(path: Path, made: Probe, pictures: Iterable[np.ndarray]) -> None:
    av = av_module()
    with av.open(file_url(path), "w") as container:
        stream = container.add_stream(made.encoder, rate=made.rate)
        stream.height, stream.width = made.luma.shape[1:]
        stream.pix_fmt = made.pixels
        options = rate_options(made)
        stream.codec_context.options = options
        stream.codec_context.thread_count = 1
        if "b" in options:
            stream.bit_rate = round(made.bits)
        for k, planes in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(planes, format=made.pixels)
            frame.pts, frame.time_base = k, 1 / made.rate
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def _decoded(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Luma [F, H, W] as it is stored, and [F] bool: B frames."""
    with av_module().open(file_url(path)) as container:
        frames = [
            (f.to_ndarray()[: f.height], int(f.pict_type) == BETWEEN) for f in container.decode(video=0)
        ]
    return np.stack([luma for luma, _ in frames]), np.array([between for _, between in frames])


def shifts_of(seen: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """[F, 2] pixels right and down of a region about its mean picture, by least squares (Lucas & Kanade 1981)."""
    inside = mask > 0.5
    mean = seen.mean(0, dtype=np.float32)
    down, right = np.gradient(mean)
    slopes = np.stack([right[inside], down[inside]])
    slopes -= slopes.mean(1, keepdims=True)
    changes = seen[:, inside].astype(np.float32) - mean[inside]
    changes -= changes.mean(1, keepdims=True)
    return np.linalg.lstsq((slopes @ slopes.T).astype(np.float64), -(slopes @ changes.T), rcond=None)[0].T


def gain_of(u: np.ndarray, tones: Sequence[Tone], j: int, times: np.ndarray) -> tuple[float, float]:
    """Of tone j in the shifts u [F, 2]: along its direction, with all tones fitted, and the error that noise makes."""
    main = tones[j].phasor
    waves = [f(2 * np.pi * t.frequency_hz * times) for t in tones for f in (np.cos, np.sin)]
    design = np.stack([np.ones(len(times)), *waves], 1)
    answer, *_ = np.linalg.lstsq(design, u, rcond=None)
    phasor = answer[1 + 2 * j] - 1j * answer[2 + 2 * j]
    size = float((np.abs(main) ** 2).sum())
    gain = float((phasor @ main.conj()).real) / size
    left = u - design @ answer
    direction = np.abs(main) / np.sqrt(size)
    steps = np.diff(times)
    if np.ptp(steps) > _UNEVEN * steps[0]:  # frames are left out: as of white noise
        power = (left**2).sum(0) / max(len(times) - design.shape[1], 1)
        return gain, float(np.sqrt(2 / len(times) * (power * direction**2).sum() / size))
    spectrum = np.fft.rfft(left * np.hanning(len(left))[:, None], axis=0)
    hz = np.arange(len(spectrum)) / (len(times) * (times[1] - times[0]))
    near = np.argsort(np.abs(hz - tones[j].frequency_hz))[:16]
    power = (np.abs(spectrum[near]) ** 2).mean(0) / (np.hanning(len(left)) ** 2).sum()
    return gain, float(np.sqrt(2 / len(times) * (power * direction**2).sum() / size))
